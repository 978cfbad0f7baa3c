"""Gaussian splatting (Kerbl et al., SIGGRAPH 2023) that starts where the prior ends: nerf/gaussians."""

from nerf.gaussians.family import SplatFamily

FAMILY = SplatFamily()
