"""Ego motion as images see it: corners followed between frames, motions, residual flow, refined poses of a drive."""
