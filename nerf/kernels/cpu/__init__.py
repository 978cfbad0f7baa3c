"""Kernels for CPUs: numba compiles each for one thread, and a pool of threads runs them on stretches of an array."""
