"""Blank frames: images that show nothing, such as a camera's black or white ones. A fit would learn that as the scene.

A frame is blank where hardly any of its patches has texture (nerf/evidence/patches.py) and others' have.
"""

import json

import cv2
import numpy as np

from eval.files import write_bytes
from nerf.evidence.patches import textured
from nerf.scene import Scene
from nerf.stack import Stack

VERSION = 1
"""Raised when other images are called blank."""
LEAST = 1e-3
"""Share of an image's pixels around which something must show; a night's only lamp has more."""


def blank_frames(scene: Scene) -> list[int]:
    """Return the positions of a scene's blank frames, held-out ones included; none where all are.

    What was found is kept beside the images, where those are files.
    """
    path = scene.images.path.parent / f"blank{VERSION}.json" if isinstance(scene.images, Stack) else None
    if path is not None and path.exists():
        return list(json.loads(path.read_text(encoding="utf-8")))
    blank = [position for position in range(len(scene.ids)) if _is_blank(scene.images[position])]
    blank = [] if len(blank) == len(scene.ids) else blank
    if path is not None:
        write_bytes(path, json.dumps(blank).encode())
    return blank


def _is_blank(image: np.ndarray) -> bool:
    """Tell whether an image (h, w, 3) shows nothing."""
    grey = cv2.cvtColor(np.ascontiguousarray(image), cv2.COLOR_RGB2GRAY).astype(np.float32)
    return bool(textured(grey).mean() < LEAST)
