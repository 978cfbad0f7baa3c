"""Kernels for GPUs in Triton, which compiles them as they are first called. Needs no CUDA toolkit; see docs/gpu.md."""
