"""The commands: argument plumbing only."""

import os

# What libraries read when they load, before anything here imports them: their threads sleep, as
# priors/machine/threads.py has it for programs that loaded them before us.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
