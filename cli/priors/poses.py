"""`priors poses`: refine a drive's poses by what its images see."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cli.arguments import DriveArguments, ThreadArguments, parse
from cli.console import out, progress
from nerf.split import EVERY_HELD_OUT, held_out
from priors.drives import CACHE
from priors.egomotion.make import make
from priors.egomotion.sight import open_eyes
from priors.errors import UsageError
from priors.selection import parse_range, select

EXAMPLES = """Refine a drive's poses by the motion that its stereo pairs, or its LiDAR and images, see between frames,
fused with its own poses so that the path does not drift. Other commands take them by --poses refined. Every 10th frame,
which `nerf fit` holds out, has no part in it: its pose follows from its neighbours.

examples:
  priors poses street/
  priors poses street/ --held-out seen                     all images take part, and scores of `nerf fit` say so
  priors build street/ --method lidar --poses refined
  nerf fit street/ --poses refined
"""


@dataclass(frozen=True)
class PosesArguments(ThreadArguments, DriveArguments):
    """Arguments of `priors poses`."""

    source: Literal["auto", "stereo", "lidar"] = "auto"
    """What tells depth. auto: the stereo pair where there is one, else the LiDAR."""
    held_out: Literal["left-out", "seen"] = "left-out"
    """Whether images and sweeps of the frames that `nerf fit` holds out take part."""
    frames: str | None = None
    """Range of frames, a:b, of which every 10th is held out, as `nerf fit` has it; all of the drive get a pose."""
    cache: Path = CACHE
    """Where the poses go, beside the drive's priors."""

    def __post_init__(self) -> None:
        super().__post_init__()
        parse_range(self.frames)
        if self.part.poses == "refined":
            raise UsageError("--poses refined: these are made here: expected auto, recorded or dead-reckoned")


ARGUMENTS = {"priors poses": PosesArguments}


def run(arguments: list[str]) -> int:
    """Refine; returns the exit code."""
    args = parse(ARGUMENTS["priors poses"], "priors poses", EXAMPLES, arguments)
    with args.limited():
        return _refine(args, ["priors", "poses", *arguments])


def _refine(args: PosesArguments, typed: list[str]) -> int:
    drive = args.open(typed)
    positions = select(drive.ids, args.frames)
    held = [drive.ids[positions[n]] for n in held_out(len(positions))] if args.held_out == "left-out" else []
    eyes = open_eyes(drive, args.source)
    with progress("refining", len(drive)) as step:
        poses = make(drive, eyes, held, args.cache, step)
    before, after = (poses.record["found"][f"residual_{when}_px"] for when in ("before", "after"))
    count = len(poses.T_world_cam)
    out.print(f"{count} poses by {eyes.source}, {poses.record['found']['seen']} motions seen between them")
    out.print(f"residual flow between neighbours, median: {_px(before)} before, {_px(after)} after")
    left_out = len(poses.record["left_out"])
    told = f"left out: {left_out} of {count} frames, every {EVERY_HELD_OUT}th" if left_out else "all frames took part"
    out.print(f"{told}\nwrote {poses.folder}")
    return 0


def _px(flow: list[float]) -> str:
    return f"{flow[0]:.3f} px sideways and {flow[1]:.3f} px vertically"
