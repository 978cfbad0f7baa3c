"""Evidence: what the posed training images, and the frames' maps among themselves, say of a prior before a fit."""
