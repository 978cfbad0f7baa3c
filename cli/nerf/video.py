"""`nerf video`: a video along the drive's path."""

from dataclasses import dataclass, field
from pathlib import Path

import tyro

from cli.arguments import parse
from cli.console import out, progress
from cli.nerf.arguments import RunArguments
from cli.written import expect_file
from nerf.video import VideoConfig, write_video

EXAMPLES = """Render a video along the drive's path: colour over depth.

examples:
  nerf video runs/NAME
  nerf video runs/NAME --frames 10:30 --steps 4 --out slow.mp4
"""


@dataclass(frozen=True)
class VideoArguments(RunArguments):
    """Arguments of `nerf video`."""

    out: Path | None = None
    """The file; default: video.mp4 in the run's folder."""
    video: tyro.conf.OmitArgPrefixes[VideoConfig] = field(default_factory=VideoConfig)


ARGUMENTS = {"nerf video": VideoArguments}


def run(arguments: list[str]) -> int:
    """Write the video; returns the exit code."""
    args = parse(VideoArguments, "nerf video", EXAMPLES, arguments)
    with args.limited():
        return _write(args, ["nerf", "video", *arguments])


def _write(args: VideoArguments, typed: list[str]) -> int:
    this_run = args.open(typed)
    path = args.out or this_run.folder / "video.mp4"
    expect_file("--out", path)
    views, model = this_run.viewpoints(args.frames), this_run.open_model(args.device)
    with progress("video", args.video.steps * (len(views.ids) - 1) + 1) as step:
        write_video(path, model.render, views.camera, views.T_world_cam, args.video, step)
    out.print(f"wrote {path}")
    return 0
