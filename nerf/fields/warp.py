"""The warp: no training, the nearest training frames by their prior's depth. What a field has to beat."""

from nerf.warp.model import WarpFamily

FAMILY = WarpFamily()
