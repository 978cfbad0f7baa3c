"""Radiance fields of streets that lean on depth priors."""

import os

# torch and numba each bring threads of their own; while one works, the other's must sleep, not spin.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
