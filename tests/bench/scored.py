"""A model's figures on a scene's held-out views, as the field benchmarks print them."""

from nerf.stress.held_out import fitted as fitted
from nerf.stress.held_out import score as score
