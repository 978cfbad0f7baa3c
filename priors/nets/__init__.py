"""The networks: one file each on one shared trunk; runtime.py runs them, weights.py finds what they learned."""

import os

# torch's and numba's OpenMP pools take turns here; a pool that spins while it waits starves the other one.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
