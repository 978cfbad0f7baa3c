"""The commands: argument plumbing only."""

import priors  # noqa: F401 - sets the number of numpy's threads before anything imports numpy
