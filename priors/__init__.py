"""Make, filter and cache metric depth priors for street drives."""

import os

from priors.cpu import hold_down

hold_down()
# The threads of numpy's matrix library spin for a tenth of a second after each product and keep the cores from
# everything else; our products are small. It helps where numpy is imported after this.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# PyTorch's threads (OpenMP) would spin after each of its steps, on the cores that our own threads then need.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
