"""Make, filter and cache metric depth priors for street drives."""

from priors.machine.cpu import hold_down

hold_down()
