"""The commands: argument plumbing only."""

import logging
import os

from priors.machine.cpu import hold_down

# What libraries read when they load, before anything here imports them: the CPU mode that was asked for, and that
# their threads sleep, as priors/machine/threads.py has it for programs that loaded them before us. Importing `priors`
# or `nerf` sets nothing.
hold_down()
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

# Without a home that can be written matplotlib keeps its settings in a temporary folder; that it does is no news.
logging.getLogger("matplotlib").setLevel(logging.ERROR)
