"""`priors check`: audit a drive, or the maps of a cache."""

from collections import Counter
from contextlib import nullcontext

from rich.text import Text

from cli.arguments import DriveArguments, parse
from cli.cache_audit import check_cache
from cli.console import DATA_ERROR, busy, err, out, progress
from priors.cache import holds_priors
from priors.check import check
from priors.check.audit import silent
from priors.drives import fitting_data_sets

EXAMPLES = """Audit a drive: calibration, missing scans, frame joins, stereo sign and vertical offset, pose continuity,
LiDAR-camera agreement. One line a finding; exits 1 where one is fatal. Of a cache it reads every map: damaged, stale
and orphaned files are named; exits 1 where one is damaged.

examples:
  priors check street/
  priors check KITTI/2011_09_26 --drive 2011_09_26_drive_0001_sync
  priors check odometry/ --drive 06 --camera image_0
  priors check cache/                                  every map of a cache
"""
STYLES = {"ok": "green", "note": "cyan", "warning": "yellow", "fatal": "bold red"}


ARGUMENTS = {"priors check": DriveArguments}


def run(arguments: list[str]) -> int:
    """Audit; returns the exit code."""
    args = parse(DriveArguments, "priors check", EXAMPLES, arguments)
    if args.data is not None and holds_priors(args.data) and not fitting_data_sets(args.data):
        return check_cache(args.data)
    with busy("opening the drive"):
        drive = args.open(["priors", "check", *arguments])
    with nullcontext() if err.moves else busy("auditing"):  # in a pipe, what is done in two seconds is not told
        findings = check(drive, progress=progress if err.moves else silent)
    for finding in findings:
        out.print(
            Text.assemble((f"{finding.level:<8}", STYLES[finding.level]), f"{finding.subject}: {finding.message}")
        )
    counts: Counter[str] = Counter(finding.level for finding in findings)
    out.print(", ".join(f"{counts[level]} {level}" for level in STYLES if counts[level]))
    return DATA_ERROR if counts["fatal"] else 0
