"""Several maps of one frame joined to one: of neighbouring moments (moments.py), of several sensors (parts.py)."""
