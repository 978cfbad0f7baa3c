"""Export: a coloured point cloud, a mesh through open3d, and the Gaussians of a field that has them.

Both are made in float32 near the path and written in the drive's own frame: where that is far from its zero, an origin
is taken off the poses and put back in float64 (priors/origin.py).
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from eval.image import as_uint8
from nerf.gaussians import ply
from nerf.model import HoldsGaussians, Model
from nerf.placed import PlacedModel
from nerf.types import OPAQUE, Render, RenderedView
from priors import origin
from priors.errors import DataError
from priors.export import triangles
from priors.export.fusion import cells_of, nearest
from priors.export.ply import POINT, Points, write_ply
from priors.export.triangles import Triangles
from priors.geometry import invert, rays
from priors.origin import Offset
from priors.types import Camera, Depth, FloatMap, Matrix

BLOCK_VOXELS, FIRST_BLOCKS, TRUNCATION_VOXELS = 16, 10_000, 4.0
Poses = npt.NDArray[np.float64]
Step = Callable[[], None]


@dataclass(frozen=True)
class CloudConfig:
    """What is taken of the rendered views."""

    opacity: float = OPAQUE
    """Least opacity of a pixel that is taken."""
    farthest_m: float = 60.0
    """Largest camera-z depth that is taken, metres: far depth is rough."""
    agreement: float = 0.1
    """Largest difference of expected and median depth, as a share of it: where they differ more, a pixel sees two
    surfaces, and its expected depth is that of neither."""
    voxel_m: float = 0.1
    """One point, or one cell of the mesh's volume, in a cube of this side, metres."""

    def __post_init__(self) -> None:
        if not (0 <= self.opacity <= 1 and self.farthest_m > 0 and self.voxel_m > 0 and self.agreement > 0):
            raise DataError(f"expected an opacity from 0 to 1, all else above 0, found {self}")


def write_cloud(
    path: Path, render: Render, camera: Camera, T_world_cam: Poses, config: CloudConfig, on_view: Step = lambda: None
) -> int:
    """Render views at poses (n, 4, 4) and write their pixels as world points, one a voxel: the one seen from nearest.

    Returns:
        How many points were written.

    Raises:
        DataError: the path does not end in .ply, or the views hold no point: nothing is written then.
    """
    if path.suffix.lower() != ".ply":
        raise DataError(f"{path}: expected a name that ends in .ply")
    kept, depth_m = np.zeros(0, POINT), np.zeros(0, np.float32)
    origin_m = origin.origin_of(T_world_cam)
    for pose, near_pose in zip(T_world_cam, origin.without(origin_m, T_world_cam), strict=True):
        points, points_m = view_points(render(pose, camera), camera, near_pose, config)
        points, points_m = np.concatenate([kept, points]), np.concatenate([depth_m, points_m])
        first = nearest(cells_of(points, config.voxel_m), points_m)
        kept, depth_m = points[first], points_m[first]
        on_view()
    if not len(kept):
        raise _nothing(path, "point", len(T_world_cam), config)
    write_ply(path, kept, origin_m)
    return len(kept)


def view_points(
    view: RenderedView, camera: Camera, T_world_cam: Matrix, config: CloudConfig
) -> tuple[Points, FloatMap]:
    """Return a view's pixels as points (n,) POINT of the pose's frame, metres, and their depths (n,), metres."""
    depth = _solid_depth(view, config)
    xyz = (rays(camera)[depth.valid] * depth.depth_m[depth.valid, None]) @ T_world_cam[:3, :3].T + T_world_cam[:3, 3]
    points = np.zeros(len(xyz), POINT)
    for axis, name in enumerate("xyz"):
        points[name] = xyz[:, axis]
    for channel, name in enumerate(("red", "green", "blue")):
        points[name] = as_uint8(view.rgb)[depth.valid][:, channel]
    return points, depth.depth_m[depth.valid]


def write_mesh(
    path: Path, render: Render, camera: Camera, T_world_cam: Poses, config: CloudConfig, on_view: Step = lambda: None
) -> int:
    """Fuse rendered views at poses (n, 4, 4) into a coloured mesh (.ply, .obj, .glb); returns its triangles.

    A truncated signed distance volume (Curless and Levoy, SIGGRAPH 1996) through open3d.

    Raises:
        DataError: the path ends in none of these, open3d cannot be imported, or the views hold no surface.
    """
    triangles.check_name(path)
    open3d = _open3d()
    image, matrix, float32 = open3d.t.geometry.Image, open3d.core.Tensor, open3d.core.float32
    grid = open3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight", "color"), (float32,) * 3, (1, 1, 3), float(config.voxel_m), BLOCK_VOXELS, FIRST_BLOCKS
    )
    # open3d cuts a point's pixel off to whole numbers: its pixels' centres are at (0.5, 0.5), ours at (0, 0).
    K = matrix(camera.K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]))
    limits = 1.0, float(config.farthest_m), TRUNCATION_VOXELS  # depth units a metre; open3d takes no int
    fused, origin_m = 0, origin.origin_of(T_world_cam)
    for pose, near_pose in zip(T_world_cam, origin.without(origin_m, T_world_cam), strict=True):
        view = render(pose, camera)
        taken = _solid_depth(view, config)
        if taken.valid.any():  # open3d refuses a view without a value
            depth, rgb = image(taken.depth_m), image(np.clip(view.rgb, 0, 1).astype(np.float32))
            extrinsic = matrix(invert(near_pose))
            blocks = grid.compute_unique_block_coordinates(depth, K, extrinsic, *limits)
            grid.integrate(blocks, depth, rgb, K, K, extrinsic, *limits)
            fused += 1
        on_view()
    mesh = _triangles(grid, origin_m) if fused else None
    if mesh is None or not len(mesh.faces):
        raise _nothing(path, "surface", len(T_world_cam), config)
    triangles.write_triangles(path, mesh)
    return len(mesh.faces)


def write_splats(path: Path, model: Model) -> int:
    """Write a field's Gaussians as .ply (nerf/gaussians/ply.py); returns how many.

    Raises:
        DataError: the path does not end in .ply, or the field is of another kind.
    """
    inner, origin_m = (model.model, model.origin_m) if isinstance(model, PlacedModel) else (model, origin.NONE)
    if not isinstance(inner, HoldsGaussians):
        raise DataError(
            f"{path}: not written: a {inner.config.family} field has no Gaussians: fit one with --field splat, or "
            "choose --kind cloud or mesh"
        )
    gaussians = inner.splats()
    ply.write(path, gaussians, origin_m)
    return len(gaussians)


def _nothing(path: Path, what: str, views: int, config: CloudConfig) -> DataError:
    """Return the error of views that hold nothing: a fog, or a scene that is farther away."""
    seen = "the view holds" if views == 1 else f"{views} views hold"
    return DataError(
        f"{path}: not written: {seen} no {what} of opacity {config.opacity:g} within {config.farthest_m:g} m: "
        "train longer, or choose another --opacity, --farthest-m or --agreement"
    )


def _triangles(grid: Any, origin_m: Offset) -> Triangles:
    """Take the surface out of open3d's volume, whose frame begins at the origin."""
    mesh = grid.extract_triangle_mesh(weight_threshold=0.5)  # one view is enough
    mesh.compute_vertex_normals()
    vertex = {name: mesh.vertex[name].numpy() for name in ("positions", "normals", "colors")}
    colours = np.rint(255 * np.clip(vertex["colors"], 0, 1)).astype(np.uint8)
    return Triangles(vertex["positions"], vertex["normals"], colours, mesh.triangle.indices.numpy(), origin_m)


def _open3d() -> Any:
    """Import open3d, or say what it lacks."""
    try:
        return import_module("open3d")
    except (ImportError, OSError) as error:
        raise DataError(
            f"a mesh needs open3d, which cannot be imported ({error}): pip install 'roadprior[mesh]' and "
            "apt-get install libusb-1.0-0 libgl1 libegl1; a point cloud needs nothing more"
        ) from error


def _solid_depth(view: RenderedView, config: CloudConfig) -> Depth:
    """Return the depth of the pixels that are taken."""
    depth = view.solid(config.opacity)
    agree = np.abs(view.median_m - depth.depth_m) <= np.float32(config.agreement) * depth.depth_m
    return depth.keep(agree & (depth.depth_m <= np.float32(config.farthest_m)))
