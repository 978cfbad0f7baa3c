"""The place for training on the GPU: one command, run with what is left of the budget."""

import os
import shlex
import subprocess
from argparse import Namespace

from tests.bench.gpu.parts import note

COMMAND: tuple[str, ...] = ()
"""What to run, from the checkout's root; empty: nothing yet. PACK, OUT and DEVICE are set in its environment. What it
prints is kept; a line that holds a JSON object is kept as figures; what it writes to OUT comes back."""


def run(options: Namespace) -> None:
    """Run the command; raise SystemExit where it fails."""
    command = shlex.split(options.train) if options.train else list(COMMAND)
    if not command:
        return note(left_out="no training command yet: tests/bench/gpu/training.py, COMMAND")
    note(command=shlex.join(command))
    places = {"PACK": str(options.pack), "OUT": str(options.out), "DEVICE": options.device}
    code = subprocess.run(command, env=os.environ | places, check=False).returncode
    if code:
        raise SystemExit(f"the training command ends with code {code}")
    return None
