"""What this CPU can do, and how to have less of it: ROADPRIOR_CPU names what kernels and libraries may use.

    ROADPRIOR_CPU=avx2 nerf fit ...      as on a CPU that has no more than AVX2

A mode is held down in one place, here: our compiled kernels ask `mode`, and each library reads a variable of its own
when it loads, which `hold_down` sets before. docs/benchmarks.md says what cannot be held down.
"""

import os
import platform
import sys
from functools import cache
from typing import Literal, cast, get_args

from priors.errors import DataError

Mode = Literal["amx", "avx512_bf16", "avx512", "avx2", "plain", "amx_emulated"]
"""From the most to the least; plain is whatever the compiler makes of 16 numbers side by side, on any CPU.

amx_emulated computes as amx does, the tiles' one product in ordinary code: for tests on CPUs without tiles.
"""
VARIABLE = "ROADPRIOR_CPU"

_HELD: dict[Mode, dict[str, str]] = {
    "avx512_bf16": {
        "ONEDNN_MAX_CPU_ISA": "AVX512_CORE_BF16",
        "ATEN_CPU_CAPABILITY": "avx512",
        "MKL_ENABLE_INSTRUCTIONS": "AVX512",
        "NUMBA_CPU_NAME": "x86-64-v4",
        "NUMBA_CPU_FEATURES": "+avx512bf16,+avx512vnni",
    },
    "avx512": {
        "ONEDNN_MAX_CPU_ISA": "AVX512_CORE_VNNI",
        "ATEN_CPU_CAPABILITY": "avx512",
        "MKL_ENABLE_INSTRUCTIONS": "AVX512",
        "NUMBA_CPU_NAME": "x86-64-v4",
        "NUMBA_CPU_FEATURES": "+avx512f",
        "OPENBLAS_CORETYPE": "SkylakeX",
    },
    "avx2": {
        "ONEDNN_MAX_CPU_ISA": "AVX2",
        "ATEN_CPU_CAPABILITY": "avx2",
        "MKL_ENABLE_INSTRUCTIONS": "AVX2",
        "NUMBA_CPU_NAME": "x86-64-v3",
        "NUMBA_CPU_FEATURES": "+avx2",
        "OPENCV_CPU_DISABLE": "AVX512-SKX",
        "OPENBLAS_CORETYPE": "Haswell",
    },
    "plain": {
        "ONEDNN_MAX_CPU_ISA": "SSE41",
        "ATEN_CPU_CAPABILITY": "default",
        "MKL_ENABLE_INSTRUCTIONS": "SSE4_2",
        "NUMBA_CPU_NAME": "x86-64",
        "NUMBA_CPU_FEATURES": "+sse2",
        "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FP16,AVX,SSE4.2,SSE4.1",
        "OPENBLAS_CORETYPE": "Nehalem",
    },
}
"""What the libraries listen to when they load. A CPU that is not x86 has one mode, and nothing to hold down.

Without features of its own numba adds the host's to the CPU it is told.
"""

_NEEDS: dict[Mode, tuple[str, ...]] = {
    "amx": ("amx-tile", "amx-bf16", "avx512bf16", "avx512f", "avx512bw", "avx512vl"),
    "avx512_bf16": ("avx512bf16", "avx512f", "avx512bw", "avx512dq", "avx512vl"),
    "avx512": ("avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"),
    "avx2": ("avx2", "fma", "f16c", "bmi2"),
    "plain": (),
}
"""LLVM's names of what a mode takes."""


def hold_down() -> None:
    """Set what the libraries listen to, where the user named a mode and did not set it; before they load.

    The commands call it first of all; a program of one's own that is to be held down does the same.

    A library that was imported before us is not held down; our own kernels always are. A wrong name is told by `mode`.
    """
    held = _HELD.get(cast(Mode, os.environ.get(VARIABLE, "")), {}) if _is_x86() else {}
    for name, value in held.items():
        os.environ.setdefault(name, value)
    if held and "numba" in sys.modules:
        sys.modules["numba"].config.reload_config()


@cache
def mode() -> Mode:
    """Return the mode that kernels are compiled for: what ROADPRIOR_CPU says, else the most that this CPU has.

    Raises DataError for a name that is none and for a mode that this CPU lacks.
    """
    asked = os.environ.get(VARIABLE, "")
    if not asked:
        return supported()[0]
    if asked not in get_args(Mode):
        raise DataError(f"{VARIABLE}={asked}: expected one of {', '.join(get_args(Mode))}")
    if asked not in supported():
        raise DataError(f"{VARIABLE}={asked}: this CPU has not got it: choose one of {', '.join(supported())}")
    return asked


@cache
def supported() -> tuple[Mode, ...]:
    """Return the modes that run here, the fastest first, amx_emulated last."""
    has = features()
    found: list[Mode] = [name for name, needed in _NEEDS.items() if has.issuperset(needed)]
    if "amx" in found and not _may_use_tiles():
        found.remove("amx")
    if not _is_x86():
        found = ["plain"]
    return (*found, "amx_emulated")


@cache
def features() -> frozenset[str]:
    """Return the CPU's features by LLVM's names, from the CPU itself: no file, any operating system."""
    from llvmlite import binding

    return frozenset(name for name, there in binding.get_host_cpu_features().items() if there)


def _is_x86() -> bool:
    return platform.machine().lower() in ("x86_64", "amd64", "x64")


def _may_use_tiles() -> bool:
    """Ask the operating system for leave to use the tiles; Linux wants to be asked once a process."""
    import torch

    return bool(torch.cpu._is_amx_tile_supported() and torch.cpu._init_amx())
