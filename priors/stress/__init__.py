"""Stress: every numerical routine on inputs at the limits of its numbers, against float64. `priors stress`."""
