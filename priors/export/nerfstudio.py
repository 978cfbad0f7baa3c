"""nerfstudio data: transforms.json, images, depth, masks and points, and the command that trains on them.

nerfstudio's conventions (its nerfstudio_dataparser.py and depth_dataset.py, 1.1): poses are camera to world with OpenGL
axes (x right, y up, z backward); the centre of the top-left pixel is at (0.5, 0.5); depth is camera z in 16-bit PNG,
0 = no value, and metres a unit are a flag of the command, not a field of the file; masks are 0 where a pixel is never
sampled; there must be depth, and a mask, for each frame or for none.
"""

import json
import shlex
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from eval.files import write_bytes
from priors import codecs
from priors.errors import expect_choices
from priors.export import place
from priors.export.fusion import FusionConfig, Step, fuse
from priors.export.ply import POINT, write_ply
from priors.export.views import PIXEL_CENTRE, View, Views
from priors.types import Camera, Image, Matrix

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""OpenCV axes to OpenGL's: y and z change sign."""
METRES = {"mm": 0.001, "1/256": 1 / 256}
"""Metres a unit of the depth PNGs."""
ENCODINGS = {"mm": "mm", "1/256": "kitti"}
POINTS_FILE = "points3D.ply"


@dataclass(frozen=True)
class NerfstudioConfig:
    """What the files hold."""

    depth_unit: Literal["mm", "1/256"] = "mm"
    """Unit of nerfstudio's depth PNGs: millimetres, its default, hold up to 65.5 m; 1/256 m up to 255.9 m, and exactly
    what the cache holds."""
    masks: Literal["none", "sky", "no-depth"] = "none"
    """Which pixels nerfstudio never samples, neither for colour: none, the sky, or those without depth."""

    def __post_init__(self) -> None:
        expect_choices(self, "")

    @property
    def metres(self) -> float:
        """Metres a unit of the depth PNGs."""
        return METRES[self.depth_unit]


@dataclass
class _Frames:
    """What was written of the views."""

    entries: list[dict[str, Any]] = field(default_factory=list)
    """Of transforms.json, each with its camera."""
    too_far: int = 0
    """Depths that the unit cannot hold."""


def write(
    folder: Path, views: Views, config: NerfstudioConfig, fusion: FusionConfig, on_view: Step = lambda: None
) -> list[str]:
    """Write the data set; what is there already is kept, transforms.json and README.txt come last.

    Returns:
        What to tell the user, a line each; the last is the command that trains on it.

    Raises:
        DataError: no map can be read, or none has a point.
        OSError: it cannot be written.
    """
    frames = _Frames()

    def write_views() -> Iterator[View]:
        for view in views:
            _write_view(folder, view, views.pose(view), config, frames)
            yield view
            on_view()

    cloud = fuse(write_views(), views.near_poses, fusion)
    points = np.zeros(len(cloud.points), POINT)
    for name in POINT.names or ():
        points[name] = cloud.points[name]
    write_ply(folder / POINTS_FILE, points, comments=("metres, in the frame of transforms.json",))
    write_bytes(folder / "transforms.json", _transforms(frames.entries, views, config.metres).encode())
    line = command(folder, config)
    place.write_readme(folder, views, [*place.origin_lines(views), *_about(config), "", line])
    lines = [f"{len(frames.entries)} frames, {len(points)} points: {folder}"]
    if frames.too_far:
        held = "1/256 holds more" if config.depth_unit == "mm" else "nothing holds more"
        lines.append(f"{frames.too_far} depths are too far for --depth-unit {config.depth_unit} and left out: {held}")
    return [*lines, line]


def command(folder: Path, config: NerfstudioConfig) -> str:
    """Return the line that trains on the data with poses and depth in metres as they are here."""
    words = ["ns-train", "depth-nerfacto", "--pipeline.model.camera-optimizer.mode", "off"]
    words += ["nerfstudio-data", "--data", str(folder), "--depth-unit-scale-factor", repr(config.metres)]
    words += ["--orientation-method", "none", "--center-method", "none", "--auto-scale-poses", "False"]
    return shlex.join(words)


def _write_view(folder: Path, view: View, T_world_cam: Matrix, config: NerfstudioConfig, frames: _Frames) -> None:
    """Write a view's files unless they are there, and note its entry."""
    image, depth, mask = (folder / part / f"{view.name}.png" for part in ("images", "depth", "masks"))
    data, too_far = codecs.encode_depth_png(view.depth.depth_m, ENCODINGS[config.depth_unit])
    if not depth.exists():
        write_bytes(depth, data)
    if not image.exists():
        codecs.write_image(image, view.rgb())
    entry: dict[str, Any] = {"file_path": f"images/{image.name}", "depth_file_path": f"depth/{depth.name}"}
    if config.masks != "none":
        if not mask.exists():
            codecs.write_image(mask, _mask(view, config))
        entry["mask_path"] = f"masks/{mask.name}"
    pose = {"transform_matrix": (T_world_cam @ FLIP).tolist()}
    frames.entries.append({**entry, **pose, **_intrinsics(view.camera)})
    frames.too_far += too_far


def _mask(view: View, config: NerfstudioConfig) -> Image:
    """Return a view's mask (height, width): 255 where pixels are sampled, 0 where not."""
    if config.masks == "no-depth":
        return np.where(view.depth.valid, 255, 0).astype(np.uint8)
    from priors.sky import sky_mask

    return np.where(sky_mask(view.frame.image()), 0, 255).astype(np.uint8)


def _intrinsics(camera: Camera) -> dict[str, float]:
    """Return a camera by nerfstudio's names, pixels."""
    K, (height, width) = camera.K, camera.size
    centre = {"cx": float(K[0, 2]) + PIXEL_CENTRE, "cy": float(K[1, 2]) + PIXEL_CENTRE}
    return {"fl_x": float(K[0, 0]), "fl_y": float(K[1, 1]), **centre, "w": width, "h": height}


def _transforms(entries: list[dict[str, Any]], views: Views, metres: float) -> str:
    """Return transforms.json; the camera stands once where all frames share it."""
    names = _intrinsics(views.frames[0].camera)
    shared = {name: entries[0][name] for name in names}
    if any(entry[name] != value for entry in entries for name, value in shared.items()):
        shared = {}
    moved = np.eye(4)[:3]
    moved[:, 3] = [-value for value in views.origin_m]
    content = {
        "camera_model": "OPENCV",
        **shared,
        **dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0),
        "applied_transform": moved.tolist(),
        "depth_unit_scale_factor": metres,
        "ply_file_path": POINTS_FILE,
        "frames": [{key: value for key, value in entry.items() if key not in shared} for entry in entries],
    }
    return json.dumps(content, indent=1) + "\n"


def _about(config: NerfstudioConfig) -> list[str]:
    """Say what the files hold."""
    return [
        "transforms.json: poses are camera to world, metres, OpenGL axes (x right, y up, z backward).",
        "The centre of the top-left pixel is (0.5, 0.5). applied_transform maps the drive's own frame to this one.",
        f"depth/: 16-bit PNG, {config.metres:g} m a unit, distance along the camera's z axis (not along the ray),",
        "0 = no value: depth-nerfacto learns nothing there. nerfstudio takes the unit from the command below; other",
        "programs find it in transforms.json (depth_unit_scale_factor).",
        "masks/, where there are any: 0 = never sampled, neither for colour.",
        f"{POINTS_FILE}: coloured points of the depth maps, metres, the same frame (splatfacto starts from them).",
        "",
        "This command keeps metres and poses as they are. nerfacto contracts space beyond 1 unit from the origin:",
        "in metres that is all of a street. Without --auto-scale-poses False it divides poses and depth by one number,",
        "which may suit it better; results are then not in metres (dataparser_transforms.json holds the number).",
    ]
