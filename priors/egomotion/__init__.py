"""Ego motion as images see it: corners followed between frames, the motion of a pair of frames, and of a whole drive."""
