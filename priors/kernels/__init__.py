"""Numba kernels, one noun a file; imported inside the functions that use them, because importing numba takes 0.5 s."""
