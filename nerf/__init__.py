"""Radiance fields of streets that lean on depth priors."""

from priors.machine.cpu import hold_down

hold_down()
