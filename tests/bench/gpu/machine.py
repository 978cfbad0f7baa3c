"""What machine it is: device, driver, and the versions of whatever the parts import."""

import os
import platform
import subprocess
from argparse import Namespace
from importlib import import_module
from typing import Any

from tests.bench.gpu.parts import PARTS, note


def run(options: Namespace) -> None:
    """Note the machine, and which modules are there; fail where a GPU is asked for and there is none."""
    note(host=f"{platform.machine()}, {os.cpu_count()} cores", python=platform.python_version())
    driver = _asked("name,driver_version,memory.total,clocks.max.sm")
    if driver:
        note(nvidia_smi=driver)
    note(modules={name: _version(name) for name in dict.fromkeys(need for part in PARTS for need in part.needs)})
    if options.device == "cpu":
        return note(device=f"CPU {platform.machine()}")
    import torch

    if not torch.cuda.is_available():
        raise SystemExit(f"torch {torch.__version__} finds no CUDA device: take --device cpu for a rehearsal")
    found = torch.cuda.get_device_properties(0)
    note(
        device=found.name,
        capability=f"{found.major}.{found.minor}",
        memory_gib=round(found.total_memory / 2**30, 1),
        multiprocessors=found.multi_processor_count,
        cuda=torch.version.cuda,
    )


def _asked(keys: str) -> str:
    """Return what nvidia-smi says; nothing where it is not there."""
    command = ["nvidia-smi", f"--query-gpu={keys}", "--format=csv,noheader"]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=15, check=False).stdout.strip()
    except (OSError, subprocess.TimeoutExpired):
        return ""


def _version(name: str) -> str | None:
    """Import a module and return its version; None where that fails: one that does not load is as good as missing."""
    try:
        module: Any = import_module(name)
    except Exception as error:
        print(f"import {name}: {type(error).__name__}: {error}")
        return None
    return str(getattr(module, "__version__", "there"))
