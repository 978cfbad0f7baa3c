"""Radiance fields of streets that lean on depth priors."""
