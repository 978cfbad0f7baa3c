"""`priors`: make, judge and look at depth priors. Each command is a file of this package, imported when it is named."""

import sys
from importlib import import_module

from cli.console import USAGE_ERROR, err, guarded, out

COMMANDS = {
    "build": "make depth maps for a drive and cache them",
    "eval": "score cached maps against the drive's truth",
    "show": "write pictures: image, depth, error and confidence side by side",
    "list": "list what a cache holds",
    "check": "audit a drive: calibration, joins, stereo, poses, LiDAR",
    "street": "write the embedded street as a KITTI raw drive",
}
FILES = {"eval": "score", "list": "listing"}

EXAMPLES = """\
  priors street street/ --frames 40 --size 1242x375     the embedded street: no download needed
  priors check street/                                  is the drive sound?
  priors build street/ --method stereo                  depth maps -> cache/
  priors build KITTI/2011_09_26 --drive 2011_09_26_drive_0001_sync --method lidar --lidar.sweeps 11
  priors build street/ --method completion --sky mask --clip 80
  priors eval cache/                                    one table, a row a prior
  priors show cache/ --frames 5:8                       pictures"""


def main() -> None:
    """Run the `priors` command."""
    raise SystemExit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run `priors` with the arguments; returns the exit code."""
    if not arguments or arguments[0] in ("-h", "--help"):
        out.print(_overview(), markup=False)
        return 0
    if arguments[0] == "--version":
        from importlib.metadata import version

        out.print(f"roadprior {version('roadprior')}")
        return 0
    name, rest = arguments[0], arguments[1:]
    if name not in COMMANDS:
        err.print(f"[bold red]error:[/] no command {name!r}: choose one of {', '.join(COMMANDS)}")
        return USAGE_ERROR
    return guarded(lambda: import_module(f"cli.{FILES.get(name, name)}").run(rest))


def _overview() -> str:
    rows = "\n".join(f"  {name:<8}{what}" for name, what in COMMANDS.items())
    parts = (
        "priors: depth priors for street drives",
        f"commands\n{rows}",
        f"examples\n{EXAMPLES}",
        "priors COMMAND --help tells the rest",
    )
    return "\n\n".join(parts)
