"""Make, filter and cache metric depth priors for street drives."""
