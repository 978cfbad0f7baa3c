"""Reference depth: what a frame knows without the single-image network. Adapting and aligning lean on it."""

from dataclasses import dataclass
from typing import Literal, Self

import numpy as np

from priors.errors import DataError
from priors.methods.lidar import Lidar
from priors.methods.stereo import Stereo
from priors.types import Depth, FloatMap, Frame, Image, Input

Source = Literal["lidar", "sparse", "stereo"]
READS: dict[Source, tuple[Input, ...]] = {"lidar": ("sweep",), "sparse": ("sparse",), "stereo": ("other",)}
TRUSTED = 0.08
"""Expected relative error up to which a stereo depth counts as reference."""
REFERENCE_FARTHEST_M = 150.0


@dataclass(frozen=True)
class ReferenceDepth:
    """Reads a frame's reference depth from one source."""

    source: Source
    lidar: Lidar
    stereo: Stereo

    @classmethod
    def choose(cls, source: Source | Literal["auto"], frame: Frame) -> Self:
        """Decide 'auto' on a frame: LiDAR, else the data set's sparse maps, else stereo; settings are resolved on it.

        A frame's own sweep alone is used: a neighbour's may be one that is held out.
        Raises DataError where the frame lacks what the source needs.
        """
        if source == "auto":
            there = [name for name, needs in READS.items() if all(frame.has(what) for what in needs)]
            if not there:
                raise DataError(f"frame {frame.id}: no LiDAR, no sparse depth and no second camera to align to")
            source = there[0]
        frame.read(READS[source][0])  # says why, where it is missing
        stereo = Stereo(offset_px=None if source == "stereo" else (0.0, 0.0, 0.0))
        return cls(source, Lidar(sweeps=1).resolve(frame), stereo.resolve(frame))

    def __call__(self, frame: Frame) -> FloatMap:
        """Return (height, width) metres, 0 = not known."""
        if self.source == "lidar":
            depth_m = self.lidar(frame).depth_m
        elif self.source == "sparse":
            depth_m = frame.sparse().depth_m
        else:
            depth_m = trusted(self.stereo(frame), frame.image())
        return np.where(depth_m < REFERENCE_FARTHEST_M, depth_m, np.float32(0))


def trusted(depth: Depth, image: Image | None = None, largest: float = TRUSTED) -> FloatMap:
    """Return the classical stereo depth (height, width) whose expected relative error is small, 0 elsewhere.

    Even sky is sometimes matched, as something near: what looks like sky in the image, if given, is left out.

    The confidence is the probability of an error below 1 m, for Laplace-distributed errors: that tells their mean.
    """
    from priors.sky import sky_mask

    chance = np.minimum(depth.trust(), np.float32(0.9999))
    error_m = 1 / np.maximum(-np.log1p(-chance), np.float32(1e-6))
    good = (depth.depth_m > 0) & (error_m < largest * depth.depth_m) & (depth.depth_m < REFERENCE_FARTHEST_M)
    if image is not None:
        good &= ~sky_mask(image)
    return np.where(good, depth.depth_m, np.float32(0))
