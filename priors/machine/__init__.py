"""The machine: what this CPU is, its threads, kernels compiled for it, its memory."""
