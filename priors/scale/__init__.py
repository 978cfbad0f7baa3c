"""Many drives in one command: on this machine, or on a Ray cluster (docs/scale.md).

    fleet = gather([DriveEntry(Path("streets/*"))])            drives.py: folders, patterns and lists -> open drives
    for tally in build_here(orders, ...): ...                  here.py: one after the other
    for tally in build_on_ray(orders, ...): ...                on_ray.py: rows (drive, frame) through actors

What runs on one frame is the same code, priors/build, and the maps are the same bytes.
"""
