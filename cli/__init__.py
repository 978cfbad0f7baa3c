"""The commands: argument plumbing only."""

import os

# As priors/__init__.py has it: here it comes before anything imports numpy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
