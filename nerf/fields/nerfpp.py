"""NeRF++ (Zhang et al., 2020) on hash grids: an inner ellipsoid and everything outside of it, inverted, a table each.

Depth is the study's composite: the inner volume's expected depth plus what its transmittance leaves of the outer's.
One ray's samples run through both, near to far, so that one compositing does it.
"""

from nerf.volumetric import VolumetricFamily

FAMILY = VolumetricFamily(space="spheres", rays_growth=4.0)
