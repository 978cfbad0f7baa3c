"""Stress: the numerical routines of fields on inputs at the limits of their numbers, and fits. `nerf stress`."""
