"""Paper: the study "Digging into Depth Priors for Outdoor Neural Radiance Fields" as one grid and one page."""
