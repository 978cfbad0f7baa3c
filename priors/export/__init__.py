"""Files for other programs: a file a format (nerfstudio, COLMAP, 3DGS, KITTI, PLY, ONNX), and what they share."""
