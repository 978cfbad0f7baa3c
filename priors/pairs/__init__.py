"""A rectified stereo pair: reading it, matching it, and the rectification error of its disparities."""
