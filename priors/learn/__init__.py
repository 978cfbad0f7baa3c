"""Training: it made the files in priors/weights, and makes yours. Its command is `priors train`: docs/training.md."""
