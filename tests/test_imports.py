"""Importing `priors` or `nerf`, and opening a network, leaves the process as it was; the commands set it up."""

import ctypes
import os
import subprocess
import sys
from pathlib import Path

import pytest

from priors.machine import cpu

ROOT = Path(__file__).resolve().parents[1]
SET_BY_COMMANDS = {"OPENBLAS_NUM_THREADS", "OMP_WAIT_POLICY"}
TELL = """
import ctypes, os

class Memory(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in "arena free fast mapped mapped_bytes a b used c d".split()]

def told():
    "Print the environment's new variables, and whether a large block comes from the system, as glibc has it untuned."
    libc = ctypes.CDLL(None)
    libc.malloc.argtypes, libc.malloc.restype = [ctypes.c_size_t], ctypes.c_void_p
    libc.mallinfo2.restype = Memory
    mapped = libc.mallinfo2().mapped_bytes
    libc.malloc(31 << 20)
    print("told:", libc.mallinfo2().mapped_bytes > mapped, *sorted(name for name in os.environ if name not in before))

before = dict(os.environ)
"""
EVERYTHING = """
import importlib, pkgutil
import nerf, priors
for package in (priors, nerf):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if "triton" not in module.name:
            importlib.import_module(module.name)
told()
"""
NETWORK = """
import torch
from priors.nets import runtime
network = runtime.open_net("cfnet", "s", "fp32")
network(torch.rand(1, 3, 64, 64), torch.rand(1, 3, 64, 64), largest_px=32)
told()
"""
COMMAND = """
import sys
from cli.priors import main
sys.argv = ["priors", "--version"]
try:
    main()
except SystemExit:
    told()
"""

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux") or not hasattr(ctypes.CDLL(None), "mallinfo2"), reason="asks glibc 2.33"
)


def tell(code: str, **variables: str) -> tuple[bool, set[str]]:
    """Run code in a process of its own; returns whether its memory is as usual, and the variables that it has set."""
    ours = SET_BY_COMMANDS | {cpu.VARIABLE} | {name for held in cpu._HELD.values() for name in held}
    environment = {name: value for name, value in os.environ.items() if name not in ours} | variables
    command = [sys.executable, "-c", TELL + code]
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, check=False)
    lines = [line.split() for line in done.stdout.splitlines() if line.startswith("told:")]
    assert len(lines) == 1, done.stderr
    return lines[0][1] == "True", set(lines[0][2:])


def test_importing_everything_sets_nothing() -> None:
    assert tell(EVERYTHING) == (True, set())


def test_nor_does_it_where_a_cpu_mode_is_asked_for() -> None:
    assert tell(EVERYTHING, **{cpu.VARIABLE: "plain"}) == (True, set())


def test_opening_and_running_a_network_sets_nothing() -> None:
    assert tell(NETWORK) == (True, set())


def test_a_command_keeps_its_memory_and_lets_threads_sleep() -> None:
    assert tell(COMMAND) == (False, SET_BY_COMMANDS)


@pytest.mark.skipif(not cpu._is_x86(), reason="other processors have one mode")
def test_a_command_holds_the_libraries_down_to_the_mode_that_is_asked_for() -> None:
    assert tell(COMMAND, **{cpu.VARIABLE: "avx2"})[1] == SET_BY_COMMANDS | set(cpu._HELD["avx2"])
