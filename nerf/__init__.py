"""Radiance fields of streets that lean on depth priors."""

from priors.cpu import hold_down

hold_down()
