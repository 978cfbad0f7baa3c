"""Score depth maps and images: arrays in, numbers out."""
