"""COLMAP text models: cameras.txt, images.txt and points3D.txt, with points and tracks from a prior's maps.

COLMAP's conventions (colmap.github.io/format.html): poses are world to camera, OpenCV axes (x right, y down, z
forward), quaternions w first; the centre of the top-left pixel is at (0.5, 0.5), so centres and pixels are ours + 0.5.
Ids begin at 1 here. The observations of an image are the points that its own map says lie in the same voxel.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from eval.files import write_bytes
from priors import codecs
from priors.export import place
from priors.export.fusion import Cloud, FusionConfig, Step, fuse
from priors.export.views import PIXEL_CENTRE, View, Views
from priors.geometry import project
from priors.types import Camera, Matrix

MODEL = Path("sparse") / "0"
IMAGES = "images"


@dataclass(frozen=True)
class Posed:
    """An image of a model."""

    name: str
    """Of its file below images/."""
    camera: Camera
    T_world_cam: Matrix
    """(4, 4) metres."""
    number: int
    """The view's number in the cloud."""


def write(folder: Path, views: Views, config: FusionConfig, on_view: Step = lambda: None) -> list[str]:
    """Write images/ and sparse/0/, and README.txt last; what is there already of the images is kept.

    Returns:
        What to tell the user, a line each.

    Raises:
        DataError: no map can be read, or none has a point.
        OSError: it cannot be written.
    """
    posed: list[Posed] = []

    def write_images() -> Iterator[View]:
        for view in views:
            posed.append(write_image(folder, view, views))
            yield view
            on_view()

    cloud = fuse(write_images(), views.near_poses, config)
    write_model(folder / MODEL, posed, cloud)
    place.write_readme(folder, views, [*place.origin_lines(views), *about(cloud, config)])
    return [f"{len(posed)} images, {len(cloud.points)} points: {folder}"]


def write_image(folder: Path, view: View, views: Views) -> Posed:
    """Write a view's image as PNG, unless it is there; returns what the model says of it."""
    path = folder / IMAGES / f"{view.name}.png"
    if not path.exists():
        codecs.write_image(path, view.rgb())
    return Posed(path.name, view.camera, views.pose(view), view.number)


def about(cloud: Cloud, config: FusionConfig) -> list[str]:
    """Say what the model's files hold."""
    return [
        "images/: the frames, PNG, rectified, without distortion.",
        "sparse/0/: a COLMAP model as text. Positions are metres. Poses are world to camera, OpenCV axes (x right,",
        "y down, z forward). The centre of the top-left pixel is (0.5, 0.5), as COLMAP has it.",
        f"points3D.txt: {len(cloud.points)} points of the prior's depth maps, one in a cube of {config.voxel_m:g} m",
        f"that {cloud.least_views} frames see or more,",
        f"not farther than {config.reach_m:g} m from the camera that sees it from nearest. ERROR is the mean distance,",
        "pixels, of a point's projection from the pixels whose depth lies in its cube.",
    ]


def write_model(folder: Path, posed: Sequence[Posed], cloud: Cloud) -> None:
    """Write cameras.txt, images.txt and points3D.txt.

    Args:
        folder: for the three files.
        posed: the images; image n of the model is posed[n - 1].
        cloud: the points, in the frame of the poses.
    """
    cameras = _cameras(posed)
    write_bytes(folder / "cameras.txt", _camera_lines(cameras).encode())
    write_bytes(folder / "images.txt", "".join(_image_lines(posed, cameras, cloud)).encode())
    write_bytes(folder / "points3D.txt", "".join(_point_lines(posed, cloud)).encode())


def world_to_camera(T_world_cam: Matrix) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return a pose (4, 4) as COLMAP has it: quaternion (4,) w x y z with w >= 0, and translation (3,), metres."""
    world_to_cam = Rotation.from_matrix(T_world_cam[:3, :3]).inv()
    quaternion = world_to_cam.as_quat()[[3, 0, 1, 2]]
    return quaternion * (1 if quaternion[0] >= 0 else -1), -world_to_cam.apply(T_world_cam[:3, 3])


def _key(camera: Camera) -> tuple[float, ...]:
    return (*camera.size, *camera.K.ravel().tolist())


def _cameras(posed: Sequence[Posed]) -> dict[tuple[float, ...], tuple[int, Camera]]:
    """Number the cameras that differ, from 1."""
    found: dict[tuple[float, ...], tuple[int, Camera]] = {}
    for image in posed:
        found.setdefault(_key(image.camera), (len(found) + 1, image.camera))
    return found


def _camera_lines(cameras: dict[tuple[float, ...], tuple[int, Camera]]) -> str:
    lines = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, fx, fy, cx, cy: pixels, the top-left pixel's centre is (0.5, 0.5)"]
    for number, camera in cameras.values():
        (height, width), K = camera.size, camera.K
        numbers = _numbers((K[0, 0], K[1, 1], K[0, 2] + PIXEL_CENTRE, K[1, 2] + PIXEL_CENTRE))
        lines.append(f"{number} PINHOLE {width} {height} {numbers}")
    return "".join(f"{line}\n" for line in lines)


def _image_lines(
    posed: Sequence[Posed], cameras: dict[tuple[float, ...], tuple[int, Camera]], cloud: Cloud
) -> Iterator[str]:
    yield "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ (world to camera, metres), CAMERA_ID, NAME\n"
    yield "# POINTS2D[] as (X, Y, POINT3D_ID)\n"
    for number, image in enumerate(posed, 1):
        quaternion, translation_m = world_to_camera(image.T_world_cam)
        place_of = _numbers((*quaternion, *translation_m))
        yield f"{number} {place_of} {cameras[_key(image.camera)][0]} {image.name}\n"
        seen = cloud.seen_by[image.number]
        xy = (seen.uv_px + PIXEL_CENTRE).tolist()
        yield " ".join(f"{x:g} {y:g} {p + 1}" for (x, y), p in zip(xy, seen.point.tolist(), strict=True)) + "\n"


def _point_lines(posed: Sequence[Posed], cloud: Cloud) -> Iterator[str]:
    yield "# POINT3D_ID, X, Y, Z (metres), R, G, B, ERROR (pixels), TRACK[] as (IMAGE_ID, POINT2D_IDX)\n"
    tracks: list[list[str]] = [[] for _ in range(len(cloud.points))]
    for number, image in enumerate(posed, 1):
        for position, point in enumerate(cloud.seen_by[image.number].point.tolist()):
            tracks[point].append(f"{number} {position}")
    xyz_m, rgb, errors = cloud.xyz_m().tolist(), cloud.rgb().tolist(), _errors(posed, cloud).tolist()
    for number, track in enumerate(tracks):
        (x, y, z), (red, green, blue) = xyz_m[number], rgb[number]
        where = f"{x:.9g} {y:.9g} {z:.9g}"
        yield f"{number + 1} {where} {red} {green} {blue} {errors[number]:.4g} {' '.join(track)}\n"


def _errors(posed: Sequence[Posed], cloud: Cloud) -> npt.NDArray[np.float64]:
    """Return the mean distance (n,) of each point's projections from the pixels of its track, pixels."""
    xyz_m, total, count = cloud.xyz_m(), np.zeros(len(cloud.points)), np.zeros(len(cloud.points))
    for image in posed:
        seen = cloud.seen_by[image.number]
        R, t_m = image.T_world_cam[:3, :3], image.T_world_cam[:3, 3]
        uv_px, _ = project(image.camera, (xyz_m[seen.point] - t_m) @ R)
        np.add.at(total, seen.point, np.linalg.norm(uv_px - seen.uv_px, axis=1))
        np.add.at(count, seen.point, 1)
    return total / np.maximum(count, 1)


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{value:.17g}" for value in values)
