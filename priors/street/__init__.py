"""The procedural street: world, pictures, LiDAR, and the KITTI raw folder that holds them.

`street.Street` makes pictures with truth from any pose; `write.write_street` writes a drive.
"""
