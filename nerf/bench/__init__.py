"""Bench: quality against time, fits side by side on one machine."""
