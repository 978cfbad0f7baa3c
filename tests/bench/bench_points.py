"""How far exported points lie from what the drive's LiDAR measured, by --views and --confidence.

    python tests/bench/bench_points.py cache/DRIVE/stereo-KEY --frames 10:26

For each point its distance to the nearest point of all sweeps from 5 frames before the range to 9 after it, the car's
motion taken out. Sky is masked. Points more than 0.8 m above the first camera are left out: no beam reaches them.
"""

import argparse
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from priors import cache, drives
from priors.errors import DataError
from priors.export.fusion import FusionConfig, fuse
from priors.export.views import choose
from priors.filters import Filters
from priors.geometry import transform, untwist
from priors.selection import select
from priors.types import Drive

BEFORE, AFTER, ABOVE_M, NEAR_M, EVERY = 5, 9, 0.8, 0.3, 5


def sweeps(drive: Drive, indices: list[int]) -> npt.NDArray[np.float64]:
    """Return the points (n, 3) of the sweeps around some frames, metres, in the drive's world frame."""
    found = []
    for index in range(max(0, indices[0] - BEFORE), min(len(drive), indices[-1] + AFTER + 1)):
        frame = drive[index]
        sweep = frame.sweep()
        if sweep is not None and frame.T_cam_lidar is not None:
            found.append(transform(frame.pose() @ frame.T_cam_lidar, untwist(sweep).astype(np.float64)))
    return np.concatenate(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("prior", type=Path, nargs="?")
    parser.add_argument("--frames", default="10:26")
    given = parser.parse_args()
    if given.prior is None:
        print("bench_points: name a prior of a drive with LiDAR")
        return
    prior = cache.only(given.prior)
    drive = drives.reopen(prior.drive)
    indices = select(drive.ids, given.frames)
    tree, first = cKDTree(sweeps(drive, indices)), drive[indices[0]].pose()
    print(f"{prior.name}, frames {given.frames}\nviews  confidence   points  median m   90 % m  within {NEAR_M} m")
    for least_views, confidence in product((1, 2, 3), (None, 0.5, 0.9)):
        views = choose(prior, drive, given.frames, Filters(sky="mask", confidence=confidence), posed=True)
        head = f"{least_views:>5}  {confidence or '-':>10}"
        try:
            cloud = fuse(views, views.near_poses, FusionConfig(views=least_views, points=10**9))
        except DataError as error:
            print(f"{head}  {error}")
            continue
        xyz_m = cloud.xyz_m() + views.origin_m
        reached = (xyz_m - first[:3, 3]) @ first[:3, 1] > -ABOVE_M
        away_m, _ = tree.query(xyz_m[reached][::EVERY])
        middle, most = np.percentile(away_m, (50, 90))
        print(f"{head}  {len(xyz_m):>7}  {middle:>8.3f}  {most:>7.3f}  {np.mean(away_m < NEAR_M):>11.1%}")


if __name__ == "__main__":
    main()
