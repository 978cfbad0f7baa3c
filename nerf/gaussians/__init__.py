"""Gaussians: scenes of many small coloured ellipsoids (Kerbl et al., SIGGRAPH 2023)."""
