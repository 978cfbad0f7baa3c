"""`priors import`: depth maps that another program made become a prior in the cache."""

from dataclasses import dataclass, field
from pathlib import Path

import tyro

from cli.arguments import DriveArguments, parse
from cli.console import DATA_ERROR, busy, err, out, progress
from priors import imported
from priors.drives import CACHE
from priors.errors import DataError
from priors.imported import Encoding, Import, ImportReport

EXAMPLES = """Take depth maps that another program made into the cache, as a prior like all others: it is scored and
used by fields. Files are joined to frames by their names (.png, .npy, .npz, .pfm). Before anything is written, they are
compared with the LiDAR, true depth or the stereo pair, where there is one of them.

examples:
  priors import street/ --depth maps/                                 .npy, .npz or .pfm, metres
  priors import street/ --depth maps/ --unit 1/256                    KITTI's PNG: metres x 256
  priors import scene/ --depth scene/depths_mono_crop --unit 1/256    what the study released
  priors import street/ --depth maps/ --unit mm --kind range          distances along the rays
  priors import street/ --depth disparities/ --unit 1/256 --kind disparity
"""


@dataclass(frozen=True)
class ImportArguments(DriveArguments):
    """Arguments of `priors import`."""

    depth: Path = field(kw_only=True)
    """Folder of the maps, as large as the images; 0, NaN and infinity are no value."""
    encoding: tyro.conf.OmitArgPrefixes[Encoding] = field(default_factory=Encoding)
    cache: Path = CACHE
    """Where the prior goes."""
    unchecked: bool = False
    """Import maps that the comparison finds wrong: relative depth, say, which `nerf fit --align` fits to the scene."""


ARGUMENTS = {"priors import": ImportArguments}


def run(arguments: list[str]) -> int:
    """Import; returns the exit code."""
    args = parse(ImportArguments, "priors import", EXAMPLES, arguments)
    with busy("looking at the drive"):
        drive = args.open(["priors", "import", *arguments])
        job = imported.prepare(drive, args.depth, args.encoding, args.cache)
    _compare(job, args.unchecked)
    with progress("imported", len(job.files)) as step:
        report = job.run(step)
    for frame_id, error in report.failed.items():
        err.complain(error, f"frame {frame_id}")
    _print_summary(job, report)
    return DATA_ERROR if report.failed else 0


def _compare(job: Import, unchecked: bool) -> None:
    """Print what the comparison finds; DataError where it is fatal and nobody said to go on."""
    with busy("comparing with other depth"):
        findings = job.compare()
    for finding in findings:
        if finding.level == "fatal" and not unchecked:
            raise DataError(f"{finding.subject} maps: {finding.message}; --unchecked imports them as they are")
        out.print(f"{finding.level}: {finding.message}")


def _print_summary(job: Import, report: ImportReport) -> None:
    there, frames = len(job.files) - len(report.written) - len(report.failed), len(job.drive.ids)
    told = [f"{len(report.written)} maps imported"]
    told += [f"{there} there already"] if there else []
    told += [f"{frames - len(job.files)} of {frames} frames have none"] if frames > len(job.files) else []
    out.print(f"{', '.join(told)}\n{job.prior.folder}")
