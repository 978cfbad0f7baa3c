"""Extrinsics: how the LiDAR is turned against the camera, and when it measures, as the drive itself shows it."""
