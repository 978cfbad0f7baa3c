"""The commands: argument plumbing only."""

import os

# Frames run in threads; a second layer of threads in the matrix library only waits for the first.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
