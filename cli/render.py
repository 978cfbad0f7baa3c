"""`nerf render`: colour and metric depth of views."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cli.arguments import parse
from cli.console import out, progress
from cli.views import Opened, RunArguments, open_views
from nerf.pictures import save_view
from priors.errors import DataError

EXAMPLES = """Render views: rgb/, depth/ (16-bit PNG, metres x 256) and depth_colour/ for each.

examples:
  nerf render runs/NAME --frames 5:9
  nerf render runs/NAME --poses new.txt --out new/     one pose a line: 12 numbers, camera to world, row by row, metres
"""


@dataclass(frozen=True)
class RenderArguments(RunArguments):
    """Arguments of `nerf render`."""

    poses: Path | None = None
    """Text file of poses (KITTI's 3x4 rows, camera to world) instead of the drive's own."""
    out: Path | None = None
    """Folder; default: views/ in the run's folder."""


def run(arguments: list[str]) -> int:
    """Render; returns the exit code."""
    args = parse(RenderArguments, "nerf render", EXAMPLES, arguments)
    with args.limited():
        return _render(args)


def _render(args: RenderArguments) -> int:
    views = open_views(args)
    if args.poses is not None:
        views = _with_poses(views, args.poses)
    folder = args.out or args.run / "views"
    with progress("render", len(views.ids)) as step:
        for id_, pose in zip(views.ids, views.T_world_cam, strict=True):
            save_view(folder, id_, views.render(pose, views.camera))
            step()
    out.print(f"wrote {len(views.ids)} views to {folder}")
    return 0


def _with_poses(views: Opened, path: Path) -> Opened:
    """Read poses (n, 4, 4) from a text file."""
    try:
        rows = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as error:
        raise DataError(f"{path}: expected 12 numbers a line ({error})") from error
    if rows.shape[1] != 12 or not np.isfinite(rows).all():
        raise DataError(f"{path}: expected 12 finite numbers a line, found {rows.shape[1]}")
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = rows.reshape(-1, 3, 4)
    return replace(views, T_world_cam=poses, ids=[f"{i:06d}" for i in range(len(rows))])
