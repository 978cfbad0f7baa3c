"""`nerf export`: a point cloud, a mesh, or the Gaussians of a field of them."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import tyro

from cli.arguments import parse
from cli.console import out, progress
from cli.nerf.arguments import RunArguments
from cli.written import expect_file
from nerf.export import CloudConfig, write_cloud, write_mesh, write_splats

EXAMPLES = """Write a coloured point cloud (.ply), or a mesh (.ply, .obj, .glb; needs open3d), in the drive's frame.
Of a field of Gaussians (--field splat) also those themselves (.ply), as viewers of 3D Gaussian splatting read them.

examples:
  nerf export                                       the only run in runs/
  nerf export runs/NAME
  nerf export runs/NAME --kind mesh --out street.glb --voxel-m 0.2
  nerf export runs/NAME --kind splats --out street.ply
"""


@dataclass(frozen=True)
class ExportArguments(RunArguments):
    """Arguments of `nerf export`."""

    kind: Literal["cloud", "mesh", "splats"] = "cloud"
    """Points, a surface through a truncated signed distance volume, or the field's own Gaussians."""
    out: Path | None = None
    """The file; default: cloud.ply, mesh.ply or splats.ply in the run's folder."""
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
    model = this_run.open_model(args.device)
    if args.kind == "splats":
        out.print(f"wrote {path}: {write_splats(path, model)} Gaussians")
        return 0
    views = this_run.viewpoints(args.frames)
    write = write_cloud if args.kind == "cloud" else write_mesh
    with progress(args.kind, len(views.ids)) as step:
        count = write(path, model.render, views.camera, views.T_world_cam, args.cloud, step)
    out.print(f"wrote {path}: {count} {'points' if args.kind == 'cloud' else 'triangles'}")
    return 0
