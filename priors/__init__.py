"""Make, filter and cache metric depth priors for street drives."""

from priors.cpu import hold_down

hold_down()
