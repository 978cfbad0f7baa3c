"""Who is told when kernels are compiled. It is apart from compiled.py, whose import of numba is slow."""

from collections.abc import Callable

on_compile: list[Callable[[str], None]] = []
"""Called with a function's name before it is compiled, on the thread that will; calls nest as functions do."""

on_compiled: list[Callable[[str], None]] = []
"""Called with its name when it is ready."""
