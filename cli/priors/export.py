"""`priors export`: a prior as files that other programs read."""

import shlex
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import tyro

from cli.arguments import find_priors, parse, reopen_drive
from cli.console import DATA_ERROR, err, out, progress
from cli.written import expect_file, expect_folder
from priors.cache import Prior
from priors.errors import UsageError
from priors.export import colmap, graphdeco, kitti, networks, place, ply
from priors.export.fusion import FusionConfig, fuse
from priors.export.nerfstudio import NerfstudioConfig
from priors.export.nerfstudio import write as write_nerfstudio
from priors.export.networks import NetworkConfig
from priors.export.views import Views, choose
from priors.filters import Filters
from priors.selection import parse_range

EXAMPLES = """Write a prior as files that other programs read: its maps with images, poses and points, or its network.
Units, axes and frames stand in each file, or in README.txt beside it. The same command goes on where it was stopped.

examples:
  priors export cache/DRIVE/stereo-KEY --to nerfstudio            and prints the ns-train line that fits
  priors export cache/DRIVE/stereo-KEY --to colmap --voxel-m 0.2
  priors export cache/DRIVE/stereo-KEY --to 3dgs --sky mask       graphdeco's trainer, with inverse depth
  priors export cache/DRIVE/stereo-KEY --to kitti --out mine.zip  a submission: depth or stereo
  priors export cache/DRIVE/stereo-KEY --to ply --frames 5:17 --confidence 0.5 --views 3
  priors export --to onnx --net cfnet-s --image-size 1242x375
"""
CACHE = Path("cache")
OUT = Path("exports")
To = Literal["nerfstudio", "colmap", "3dgs", "kitti", "ply", "onnx"]
SUFFIXES = {"kitti": ".zip", "ply": ".ply", "onnx": ".onnx"}
"""Endings of the formats that are one file; the others are folders."""
PLY_POINTS = 1_000_000
"""Points of a PLY file where --points says nothing."""
READ_BY = {
    "filters": ("nerfstudio", "colmap", "3dgs", "kitti", "ply"),
    "fusion": ("nerfstudio", "colmap", "3dgs", "ply"),
    "nerfstudio": ("nerfstudio",),
    "network": ("onnx",),
}
"""Which formats read a group of flags."""


@dataclass(frozen=True)
class ExportArguments:
    """Arguments of `priors export`."""

    prior: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[PRIOR]")] = None
    """A prior's folder, or one that holds a single prior; default: cache/."""
    to: To = field(kw_only=True)
    """What to write: nerfstudio, colmap and 3dgs are folders with images, poses, depth and points; kitti is a
    submission's zip, ply a point cloud, onnx a network."""
    out: Path | None = None
    """Where to: a new folder or file, or one that an export wrote; default: exports/DRIVE-PRIOR-FORMAT."""
    frames: str | None = None
    """Only this range of frames, a:b."""
    data: Path | None = None
    """Where the drive is now, if it has moved since the build."""
    benchmark: Literal["auto", "completion", "prediction", "stereo2012", "stereo2015"] = "auto"
    """Which of KITTI's benchmarks --to kitti is for: depth completion or prediction, or stereo; auto: by the frames'
    names, the camera and the method."""
    filters: tyro.conf.OmitArgPrefixes[Filters] = field(default_factory=Filters)
    fusion: tyro.conf.OmitArgPrefixes[FusionConfig] = field(default_factory=FusionConfig)
    nerfstudio: tyro.conf.OmitArgPrefixes[NerfstudioConfig] = field(default_factory=NerfstudioConfig)
    network: tyro.conf.OmitArgPrefixes[NetworkConfig] = field(default_factory=NetworkConfig)

    def __post_init__(self) -> None:
        parse_range(self.frames)
        if self.to not in get_args(To):
            raise UsageError(f"--to {self.to}: expected one of {', '.join(get_args(To))}")
        for group, readers in READ_BY.items():
            given = getattr(self, group)
            fresh = type(given)()
            changed = [each.name for each in fields(given) if getattr(given, each.name) != getattr(fresh, each.name)]
            if changed and self.to not in readers:
                raise UsageError(f"--{changed[0].replace('_', '-')}: {_unread(self.to, readers)}")
        if self.benchmark != "auto" and self.to != "kitti":
            raise UsageError(f"--benchmark: {_unread(self.to, ('kitti',))}")
        for flag in ("frames", "data"):
            if getattr(self, flag) is not None and self.to == "onnx":
                raise UsageError(f"--{flag}: {_unread('onnx', READ_BY['filters'])}")

    def place(self, name: str) -> Path:
        """Return where it goes, and tell before any work where that cannot be written."""
        suffix = SUFFIXES.get(self.to, "")
        last = suffix if suffix == f".{self.to}" else f"-{self.to}{suffix}"
        path = self.out or OUT / f"{name}{last}"
        if suffix:
            expect_file("--out", path, [suffix])
            place.expect_ours(path)
        else:
            expect_folder("--out", path)
        return path


ARGUMENTS = {"priors export": ExportArguments}


def run(arguments: list[str]) -> int:
    """Write the files; returns the exit code."""
    args = parse(ExportArguments, "priors export", EXAMPLES, arguments)
    typed = ["priors", "export", *arguments]
    return _export_network(args, typed) if args.to == "onnx" else _export_maps(args, typed)


def _export_network(args: ExportArguments, typed: list[str]) -> int:
    named = args.network.net is not None or args.network.weights is not None
    if named and args.prior is not None:
        raise UsageError(f"{args.prior}: name a prior, or a network by --net or --weights, not both")
    wanted = not named and (args.prior is not None or CACHE.is_dir())
    exported = networks.decide(args.network, the_prior(args.prior or CACHE, typed) if wanted else None)
    return _tell(networks.write(args.place(exported.name), exported))


def _export_maps(args: ExportArguments, typed: list[str]) -> int:
    prior = the_prior(args.prior or CACHE, typed)
    drive = reopen_drive([prior], data=args.data)
    views = choose(prior, drive, args.frames, args.filters, posed=args.to != "kitti")
    path = args.place(f"{drive.name}-{prior.name}")
    write, steps = WRITERS[args.to]
    with progress(f"export {args.to}", steps * len(views)) as step:
        lines = write(args, path, views, step)
    for id_, why in {**views.unplaced, **views.unread}.items():
        err.complain(why, f"left out: frame {id_}")
    return _tell(lines) or (DATA_ERROR if views.unread else 0)


def the_prior(path: Path, typed: list[str]) -> Prior:
    """Return the one prior at path; UsageError where there are several: each is listed as the command that takes it."""
    found = find_priors(path)
    if len(found) > 1:
        words = [word for word in typed if word != str(path)]
        lines = [f"\n  {shlex.join([*words[:2], str(one.folder), *words[2:]])}" for one in found]
        raise UsageError(f"{path}: holds {len(found)} priors: name one:{''.join(lines)}")
    return found[0]


def _write_nerfstudio(args: ExportArguments, folder: Path, views: Views, step: Callable[[], None]) -> list[str]:
    place.claim(folder, place.record(views, args.to, _options(args.fusion, args.nerfstudio)))
    return write_nerfstudio(folder, views, args.nerfstudio, args.fusion, step)


def _write_colmap(args: ExportArguments, folder: Path, views: Views, step: Callable[[], None]) -> list[str]:
    place.claim(folder, place.record(views, args.to, _options(args.fusion)))
    return colmap.write(folder, views, args.fusion, step)


def _write_3dgs(args: ExportArguments, folder: Path, views: Views, step: Callable[[], None]) -> list[str]:
    place.claim(folder, place.record(views, args.to, _options(args.fusion)))
    return graphdeco.write(folder, views, args.fusion, step)


def _write_kitti(args: ExportArguments, path: Path, views: Views, step: Callable[[], None]) -> list[str]:
    return kitti.write(path, views, kitti.benchmark_of(views) if args.benchmark == "auto" else args.benchmark, step)


def _write_ply(args: ExportArguments, path: Path, views: Views, step: Callable[[], None]) -> list[str]:
    def stepped() -> Any:
        for view in views:
            yield view
            step()

    cloud = fuse(stepped(), views.near_poses, args.fusion, PLY_POINTS)
    ply.write_ply(path, cloud.points, views.origin_m, (*place.heading(views), *ply.FIELDS))
    return [f"{len(cloud.points)} points: {path}"]


WRITERS: dict[str, tuple[Callable[..., list[str]], int]] = {
    "nerfstudio": (_write_nerfstudio, 1),
    "colmap": (_write_colmap, 1),
    "3dgs": (_write_3dgs, 2),
    "kitti": (_write_kitti, 1),
    "ply": (_write_ply, 1),
}
"""What writes a format, and how often it looks at each view."""


def _options(*configs: Any) -> dict[str, Any]:
    """Return settings as JSON holds them."""
    return {each.name: getattr(config, each.name) for config in configs for each in fields(config)}


def _unread(to: str, readers: tuple[str, ...]) -> str:
    others = " and ".join([part for part in (", ".join(readers[:-1]), readers[-1]) if part])
    return f"--to {to} does not read it, {others} {'does' if len(readers) == 1 else 'do'}: leave it out"


def _tell(lines: list[str]) -> int:
    for line in lines:
        out.print(line, soft_wrap=True)  # what is to be copied stays one line
    return 0
