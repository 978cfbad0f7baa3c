"""Training: made the files in priors/weights, and makes yours. `priors train` is its command, see docs/training.md."""
