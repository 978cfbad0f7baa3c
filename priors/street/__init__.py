"""The procedural street: world, pictures, LiDAR, and the KITTI raw folder that holds them.

`priors.street.street.Street` makes pictures with truth from any pose; `priors.street.write.write_street` writes a drive.
"""
