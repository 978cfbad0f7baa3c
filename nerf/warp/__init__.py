"""The warp: a field without training, the nearest training frames drawn into a view by their prior's depth."""
