"""`nerf export`: a point cloud or a mesh."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import tyro

from cli.arguments import parse
from cli.console import out, progress
from cli.nerf.arguments import RunArguments
from cli.written import expect_file
from nerf.export import CloudConfig, write_cloud, write_mesh

EXAMPLES = """Write a coloured point cloud (.ply), or a mesh (.ply, .obj, .glb; needs open3d), in the drive's frame.

examples:
  nerf export                                       the only run in runs/
  nerf export runs/NAME
  nerf export runs/NAME --kind mesh --out street.glb --voxel-m 0.2
"""


@dataclass(frozen=True)
class ExportArguments(RunArguments):
    """Arguments of `nerf export`."""

    kind: Literal["cloud", "mesh"] = "cloud"
    """Points, or a surface through a truncated signed distance volume."""
    out: Path | None = None
    """The file; default: cloud.ply or mesh.ply in the run's folder."""
    cloud: tyro.conf.OmitArgPrefixes[CloudConfig] = field(default_factory=CloudConfig)


ARGUMENTS = {"nerf export": ExportArguments}


def run(arguments: list[str]) -> int:
    """Write the file; returns the exit code."""
    args = parse(ExportArguments, "nerf export", EXAMPLES, arguments)
    with args.limited():
        return _export(args, ["nerf", "export", *arguments])


def _export(args: ExportArguments, typed: list[str]) -> int:
    this_run = args.open(typed)
    path = args.out or this_run.folder / f"{args.kind}.ply"
    expect_file("--out", path)
    views, model = this_run.viewpoints(args.frames), this_run.open_model(args.device)
    write = write_cloud if args.kind == "cloud" else write_mesh
    with progress(args.kind, len(views.ids)) as step:
        count = write(path, model.render, views.camera, views.T_world_cam, args.cloud, step)
    out.print(f"wrote {path}: {count} {'points' if args.kind == 'cloud' else 'triangles'}")
    return 0
