"""Radiance fields of streets that lean on depth priors."""

import os

from priors.cpu import hold_down

hold_down()
# As priors/__init__.py has it: PyTorch's threads must sleep, not spin, while ours work.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
