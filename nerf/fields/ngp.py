"""Instant-NGP (Müller et al., SIGGRAPH 2022): a hash grid in a box, marched through its occupancy grid.

What lies outside of the box is contracted into a shell around it.
"""

from nerf.volumetric import VolumetricFamily

FAMILY = VolumetricFamily(space="cube", rays_growth=4.0)
