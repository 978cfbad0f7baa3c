"""A sparse model as COLMAP's "Output format" describes it, text or binary, with images and points on the wall."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from layouts.posed import BENT, CX, CY, FX, FY, SIZE, WALL_M, Taken, take
from scipy.spatial.transform import Rotation

from priors import codecs

MODELS = {
    "SIMPLE_PINHOLE": (0, (FX, CX + 0.5, CY + 0.5)),
    "PINHOLE": (1, (FX, FY, CX + 0.5, CY + 0.5)),
    "SIMPLE_RADIAL": (2, (FX, CX + 0.5, CY + 0.5, BENT[0])),
    "RADIAL": (3, (FX, CX + 0.5, CY + 0.5, BENT[0], BENT[1])),
    "OPENCV": (4, (FX, FY, CX + 0.5, CY + 0.5, *BENT)),
    "OPENCV_FISHEYE": (5, (FX, FY, CX + 0.5, CY + 0.5, 0.01, 0.0, 0.0, 0.0)),
    "FULL_OPENCV": (6, (FX, FY, CX + 0.5, CY + 0.5, *BENT, 0.0, 0.0, 0.0, 0.0)),
}
"""Model -> its number and parameters, all of the camera of layouts.posed as far as the model can say it."""
POINTS = [(7 + n, (-2.0 + 0.5 * n, -1.0 + 0.3 * n, WALL_M)) for n in range(8)]
"""Ids, with gaps before them, and places on the wall."""


@dataclass
class Model:
    """What is written."""

    model: str
    views: list[Taken]
    seen: dict[str, list[int]] = field(default_factory=dict)
    """Image's name -> ids of the points that it observes."""

    def pose(self, view: Taken) -> tuple[list[float], list[float]]:
        """Return T_cam_world as a quaternion (w x y z) and a translation."""
        R = view.T_world_cam[:3, :3].T
        x, y, z, w = Rotation.from_matrix(R).as_quat().tolist()
        return [w, x, y, z], (-R @ view.T_world_cam[:3, 3]).tolist()


def write_colmap(root: Path, model: str = "OPENCV", binary: bool = True, place: str = "sparse/0") -> Model:
    """Write the folder; each image observes another part of the points, the last one none."""
    bent = () if "PINHOLE" in model else BENT
    written = Model(model, [take(f"shot_{number}.png", number, bent) for number in range(3)])
    for number, view in enumerate(written.views):
        codecs.write_image(root / "images" / view.name, view.image)
        written.seen[view.name] = [id_ for id_, _ in POINTS[number : number + 4]] if number < 2 else []
    (root / place).mkdir(parents=True, exist_ok=True)
    (_write_bytes if binary else _write_text)(root / place, written)
    return written


def _write_text(folder: Path, written: Model) -> None:
    words = " ".join(map(repr, MODELS[written.model][1]))
    camera = f"3 {written.model} {SIZE[1]} {SIZE[0]} {words}\n"
    (folder / "cameras.txt").write_text(f"# Camera list with one line of data per camera:\n{camera}")
    lines = ["# Image list with two lines of data per image:"]
    for number, view in enumerate(written.views):
        q, t = written.pose(view)
        lines.append(" ".join(map(repr, [number + 1, *q, *t])) + f" 3 {view.name}")
        lines.append(" ".join(["1.5 2.5 -1", *(f"{3.5 + id_} 4.5 {id_}" for id_ in written.seen[view.name])]))
    lines[-1] = ""  # the last image observes nothing
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    rows = [f"{id_} {x!r} {y!r} {z!r} 10 20 30 0.5{_track(written, id_)}" for id_, (x, y, z) in POINTS]
    (folder / "points3D.txt").write_text("# 3D point list\n" + "\n".join(rows) + "\n")


def _track(written: Model, id_: int) -> str:
    return "".join(f" {image} {place}" for image, place in tracks(written, id_))


def tracks(written: Model, id_: int) -> list[tuple[int, int]]:
    """Return the images that observe a point, and where in their lists: the first place of each list observes none."""
    found = []
    for number, view in enumerate(written.views):
        if id_ in written.seen[view.name]:
            found.append((number + 1, written.seen[view.name].index(id_) + 1))
    return found


def _write_bytes(folder: Path, written: Model) -> None:
    number, parameters = MODELS[written.model]
    camera = struct.pack("<QIiQQ", 1, 3, number, SIZE[1], SIZE[0]) + struct.pack(f"<{len(parameters)}d", *parameters)
    (folder / "cameras.bin").write_bytes(camera)
    images = struct.pack("<Q", len(written.views))
    for number, view in enumerate(written.views):
        q, t = written.pose(view)
        images += struct.pack("<I7dI", number + 1, *q, *t, 3) + view.name.encode() + b"\0"
        seen: Sequence[int] = written.seen[view.name]
        listed = [(1.5, 2.5, -1), *((3.5 + id_, 4.5, id_) for id_ in seen)] if seen else []
        images += struct.pack("<Q", len(listed)) + b"".join(struct.pack("<ddq", *each) for each in listed)
    (folder / "images.bin").write_bytes(images)
    points = struct.pack("<Q", len(POINTS))
    for id_, xyz in POINTS:
        track = tracks(written, id_)
        points += struct.pack("<Q3d3BdQ", id_, *xyz, 10, 20, 30, 0.5, len(track))
        points += b"".join(struct.pack("<II", *each) for each in track)
    (folder / "points3D.bin").write_bytes(points)


def projected(view: Taken, K: np.ndarray, ids: Sequence[int]) -> list[tuple[int, int, float]]:
    """Column, row and depth of points as a straight camera sees them, one by one; those outside are left out."""
    found = []
    for id_ in ids:
        xyz = view.T_world_cam[:3, :3].T @ (np.array(dict(POINTS)[id_]) - view.T_world_cam[:3, 3])
        u, v, _ = K @ xyz / xyz[2]
        if -0.5 < u < SIZE[1] - 0.5 and -0.5 < v < SIZE[0] - 0.5:
            found.append((round(u), round(v), xyz[2]))
    return found
