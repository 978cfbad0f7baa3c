"""Who wants to know when kernels are compiled; apart from compiled.py, which brings numba, so that asking is quick."""

from collections.abc import Callable

on_compile: list[Callable[[str], None]] = []
"""Called with a function's name before it is compiled, on the thread that will; calls nest as functions do."""

on_compiled: list[Callable[[str], None]] = []
"""Called with its name when it is ready."""
