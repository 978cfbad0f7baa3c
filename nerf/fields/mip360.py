"""MipNeRF-360 (Barron et al., CVPR 2022) on a hash grid, as in Zip-NeRF: contracted space, proposals, cones.

The contraction to a ball of radius 2, a proposal network trained by the interlevel loss, the distortion loss, and
samples with an extent (levels of the grid fade where the pixel's cone is wider than their cells).
"""

from nerf.volumetric import VolumetricFamily

FAMILY = VolumetricFamily(space="ball", proposals=(48,), anti_aliased=True, distortion=10.0)
