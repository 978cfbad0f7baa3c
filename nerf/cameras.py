"""Cameras: where a run's frames were seen from, kept in its folder; its field is then shown without the drive.

<run>/cameras.json    ids, K (3, 3) pixels, size (height, width), T_world_cam (n, 4, 4) camera to world, metres
"""

import json
from pathlib import Path

import numpy as np

from eval.files import write_bytes
from nerf.scene import Scene
from nerf.viewpoints import Viewpoints
from priors import origin
from priors.types import Camera

NAME = "cameras.json"
PREPARED = "*/frames.json"
"""Where runs of earlier versions have theirs: what was prepared beside them (nerf.prepare) is written alike."""


def keep(folder: Path, scene: Scene) -> None:
    """Write the cameras of a scene's frames into a run's folder, in the drive's own frame."""
    poses = origin.put_back(scene.origin_m, scene.T_world_cam)
    K, size = scene.camera.K.tolist(), list(scene.camera.size)
    record = {"ids": list(scene.ids), "K": K, "size": size, "T_world_cam": poses.tolist()}
    write_bytes(folder / NAME, json.dumps(record).encode())


def kept(folder: Path, scenes: Path, drive: str) -> Viewpoints | None:
    """Return the cameras of a run's frames; None where there are none, or where it is not certain which they are.

    Args:
        folder: the run's.
        scenes: holds what was prepared for it and for others, for runs that kept nothing themselves.
        drive: the drive's name, with which the folders there begin.
    """
    if (folder / NAME).exists():
        return _read(folder / NAME)
    found = [path for path in sorted(scenes.glob(PREPARED)) if drive and path.parent.name.startswith(drive)]
    return _read(found[0]) if len(found) == 1 else None


def _read(path: Path) -> Viewpoints | None:
    """Read a record; None where it is damaged."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
        ids = [str(id_) for id_ in record["ids"]]
        poses = np.array(record["T_world_cam"], dtype=np.float64).reshape(len(ids), 4, 4)
        height, width = map(int, record["size"])
        camera = Camera(np.array(record["K"], dtype=np.float64).reshape(3, 3), (height, width))
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return Viewpoints(camera, ids, poses) if ids else None
