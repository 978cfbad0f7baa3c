"""Radiance fields of streets that lean on depth priors."""

import os

from priors.cpu import hold_down

hold_down()
# torch and numba each bring threads of their own; while one works, the other's must sleep, not spin.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
