"""Limits that the compiled renderer and its twin share."""

REACH = 3.0
"""How many standard deviations around the prior URF's line of sight reaches."""
LEAST = 1e-12
"""Smallest opacity whose logarithm is taken."""
NO_TARGET = 1e-6
"""A ray none of whose samples lies near the prior has no target: its KL is 0."""
SOFT = 1e-7
"""Added to the weights that the interlevel loss divides by."""
