"""The field in plain PyTorch: short, differentiable, any device and precision. What the kernels must equal."""
