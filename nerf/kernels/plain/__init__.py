"""Kernels for devices without their own: the twin in plain PyTorch and its autograd. Slow, and right."""
