"""Instant-NGP (Müller et al., SIGGRAPH 2022): a hash grid in a box, marched through its occupancy grid."""

from nerf.volumetric import VolumetricFamily

FAMILY = VolumetricFamily(space="box")
