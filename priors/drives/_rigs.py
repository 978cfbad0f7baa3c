"""Cars whose stereo pairs have a known rectification error, for drives that cannot measure it."""

from priors.types import Rig

KITTI = Rig("kitti", focal_px=718.0, shift_px=0.5, tilt_px=0.0, yaw_px=1.1, pitch_px=-0.7, scale=0.981)
"""How it was measured: docs/methods/stereo.md."""
RIGS = {KITTI.name: KITTI}
