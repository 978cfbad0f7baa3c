"""`nerf render`: colour and metric depth of views."""

from dataclasses import dataclass
from pathlib import Path

from cli.arguments import parse
from cli.console import out
from cli.nerf.arguments import RunArguments
from cli.written import expect_folder
from nerf.viewpoints import read_poses

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


ARGUMENTS = {"nerf render": RenderArguments}


def run(arguments: list[str]) -> int:
    """Render; returns the exit code."""
    args = parse(RenderArguments, "nerf render", EXAMPLES, arguments)
    with args.limited():
        return _render(args, ["nerf", "render", *arguments])


def _render(args: RenderArguments, typed: list[str]) -> int:
    this_run = args.open(typed)
    folder = args.out or this_run.folder / "views"
    expect_folder("--out", folder)
    views = this_run.viewpoints(args.frames)
    if args.poses is not None:
        views = read_poses(args.poses, views.camera)
    this_run.render(views, folder, args.device)
    out.print(f"wrote {len(views.ids)} views to {folder}")
    return 0
