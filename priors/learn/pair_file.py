"""One training sample on disk: a stereo pair with exact truth, and what a LiDAR beside it would see."""

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from priors import codecs
from priors.errors import DataError
from priors.types import Camera, FloatMap, Image, Mask

PER_WORLD = 24
"""Samples drawn of one world."""
PER_PX = 256
"""Disparities are stored in 1/256 px, as KITTI's are; 0 = sky or beyond what that can tell."""


@dataclass(frozen=True, slots=True)
class Sample:
    """A rectified pair and its truth, for the left camera."""

    left: Image
    """(h, w, 3) uint8 RGB."""
    right: Image
    """(h, w, 3) uint8 RGB."""
    disparity_px: FloatMap
    """(h, w); 0 = no truth, or infinitely far where `sky` says so."""
    sky: Mask
    """(h, w)."""
    camera: Camera
    baseline_m: float
    points_m: npt.NDArray[np.float32]
    """(n, 3) LiDAR points that fall into the left image, in its camera's axes; those behind an edge are among them."""
    beam: npt.NDArray[np.uint8]
    """(n,) the scan line of each point, 0 = the highest."""

    @property
    def depth_m(self) -> FloatMap:
        """Return camera-z depth (h, w), metres; 0 = none."""
        reach = np.float32(self.camera.fx * self.baseline_m)
        safe = np.maximum(self.disparity_px, np.float32(1e-6))
        return np.where(self.disparity_px > 0, reach / safe, np.float32(0)).astype(np.float32)


def write(path: Path, sample: Sample) -> None:
    """Write a sample to one .npz file, atomically; not compressed: reading it must cost nothing beside training."""
    buffer = io.BytesIO()
    np.savez(
        buffer,
        left=sample.left,
        right=sample.right,
        disparity=np.minimum(np.rint(sample.disparity_px * PER_PX), 65535).astype(np.uint16),
        sky=np.packbits(sample.sky),
        K=sample.camera.K,
        baseline_m=sample.baseline_m,
        points_m=sample.points_m.astype(np.float32),
        beam=sample.beam,
    )
    codecs.write_bytes(path, buffer.getvalue())


def read(path: Path) -> Sample:
    """Read a sample; DataError where the file is damaged."""
    try:
        with np.load(path) as file:
            size = file["left"].shape[:2]
            sky = np.unpackbits(file["sky"], count=size[0] * size[1]).reshape(size).astype(np.bool_)
            return Sample(
                file["left"],
                file["right"],
                (file["disparity"] / np.float32(PER_PX)).astype(np.float32),
                sky,
                Camera(file["K"], (int(size[0]), int(size[1]))),
                float(file["baseline_m"]),
                file["points_m"],
                file["beam"],
            )
    except (OSError, ValueError, KeyError, EOFError) as error:
        raise DataError(f"{path}: damaged training sample ({error}): delete it and render again") from error
