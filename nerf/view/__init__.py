"""A field, live in a browser: rendered as the camera moves, coarse to fine."""
