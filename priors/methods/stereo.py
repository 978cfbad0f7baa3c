"""Depth from a stereo pair: classical semi-global matching, or a network; with a confidence that is a probability."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Literal, Self

import numpy as np

from priors.codecs import FARTHEST_M
from priors.errors import DataError
from priors.machine import threads
from priors.methods import _stereo_classical as classical
from priors.pairs.matching import largest_disparity, match, quarter_match
from priors.pairs.offset import NONE, Offset
from priors.pairs.read import baseline, calibrate, find_range, read_pair, unmirror
from priors.sky import doubt, rows_below, sky_mask
from priors.types import Depth, Drive, FloatMap, Frame, Image

SURE = 0.9
"""Confidence of a network's pixels that the offset is measured on."""


@dataclass(frozen=True)
class Stereo:
    """Match the pair, by hand-made rules or by a network, and tell how far to trust it.

    Every pixel has a value where anything could be matched. The classical confidence is the probability that the depth
    is right within 1 m; a network's is the probability that its disparity is right within 1 px, and 0 beyond 250 m.
    """

    model: Literal["classical", "cfnet", "pcwnet"] = "classical"
    """classical: semi-global matching, smoothed and filled by what the image says; the others are networks."""
    size: Literal["s", "m", "l"] = "s"
    """Of a network: small is faster, large is better."""
    runtime: Literal["auto", "bf16", "fp32", "int8", "cuda", "onnx"] = "auto"
    """What runs a network; auto: CUDA where there is one, else what a table says is fastest on this CPU."""
    weights: Path | None = None
    """Your own weights for the network, .safetensors or .onnx; default: those that come with the package."""
    max_disparity_px: int | None = None
    """Largest disparity searched; default: what each pair's scene needs."""
    offset_px: tuple[float, ...] | None = None
    """a b c e: scale * disparity + a + b X + c X^2 + e X Y is what the calibration promises, X = (column - cx) / fx and
    Y = (row - cy) / fy; what is not given is 0. Default: measured, with the scale, against the LiDAR sweep of the
    drive's first frame; where there is none, what the rig's pairs usually have (KITTI), else 0. Give 0 0 0 for depth
    from the images alone."""
    scale: float | None = None
    """See offset-px. Default: measured with it; 1 where the offset is given."""

    VERSION: ClassVar[int] = 1

    def __post_init__(self) -> None:
        if self.max_disparity_px is not None and self.max_disparity_px < 1:
            raise DataError(f"stereo: max disparity is {self.max_disparity_px}, expected 1 or more pixels")
        if self.model == "classical" and self.weights is not None:
            raise DataError(f"--stereo.weights {self.weights}: which network is it of? Name it by --stereo.model")
        if self.offset_px is not None and len(self.offset_px) > len(NONE.field_px):
            raise DataError(f"--stereo.offset-px: {len(self.offset_px)} numbers, expected at most a b c e")
        if self.scale is not None and (self.offset_px is None or not 0.5 < self.scale < 2):
            raise DataError(f"--stereo.scale {self.scale}: expected about 1, and --stereo.offset-px beside it")

    @property
    def reads(self) -> tuple[str, ...]:
        """Return what a frame must have."""
        return ("image", "other")

    @threads.limited(None)
    def resolve(self, frame: Frame) -> Self:
        """Return the config with the runtime chosen, and the offset measured on this frame or the rig's usual one."""
        resolved = self
        if self.model == "classical":
            resolved = replace(self, size=type(self).size, runtime=type(self).runtime)  # they decide nothing
        else:
            from priors.nets import runtime

            resolved = replace(self, runtime=runtime.choose(self.runtime, self.weights, self.model, self.size))
        offset = self.correction() if self.offset_px is not None else calibrate(frame, resolved._sure)
        return replace(resolved, offset_px=offset.field_px, scale=offset.scale)

    def weights_digest(self) -> str | None:
        """Return the hash of the network's weights, for the cache's key; None for the classical method."""
        if self.model == "classical":
            return None
        from priors.nets import int8, weights

        file = weights.find(self.model, self.size, self.weights)
        return (int8 if self.runtime == "int8" else weights).digest(file)

    def prepare(self, drive: Drive, folder: Path, on_note: Callable[[str], None]) -> Self:
        """Tell what the disparity is corrected by, if it is; see build.build."""
        offset = self.correction()
        if offset != NONE:
            a, b, c, e = (f"{value:+.2f}" for value in offset.field_px)
            on_note(
                f"the disparity d is made {offset.scale:.3f} d {a} {b} X {c} X² {e} XY px, for the calibration is off: "
                "docs/methods/stereo.md; --stereo.offset-px 0 0 0: as matched"
            )
        return self

    @threads.limited(None)
    def __call__(self, frame: Frame) -> Depth:
        """Make the depth map (height, width), metres along the camera's z axis; the sky's confidence is 0.

        Raises DataError where the pair, its baseline or the network's weights are missing, where the two images differ
        in size, and where left and right are swapped.
        """
        fx_baseline = frame.camera.fx * baseline(frame)
        image, other = read_pair(frame)
        needed_px = find_range(frame, image, other)
        sky = sky_mask(image)
        rows = rows_below(sky)
        disparity_px, trust = np.zeros(sky.shape, np.float32), np.ones(sky.shape, np.float32)
        disparity_px[rows], trust[rows] = self._match(image[rows], other[rows], self.max_disparity_px or needed_px)
        disparity_px, trust = unmirror(frame, disparity_px), unmirror(frame, trust)
        found = disparity_px > 0
        disparity_px = self.correction().correct(disparity_px, frame.camera)
        least_px = np.float32(fx_baseline / FARTHEST_M)
        beyond = disparity_px <= least_px
        np.maximum(disparity_px, least_px, out=disparity_px)
        depth_m = np.where(found, np.float32(fx_baseline) / disparity_px, np.float32(0))
        if self.model == "classical":
            trust = classical.probability(disparity_px, trust, fx_baseline)
        else:
            found &= ~beyond  # the disparity of the sky may be right, but its depth is not known
        return doubt(Depth(depth_m, np.where(found, trust, np.float32(0))), unmirror(frame, sky))

    def correction(self) -> Offset:
        """Return what the matched disparities are corrected by."""
        a, b, c, e = (*(self.offset_px or ()), *NONE.field_px)[: len(NONE.field_px)]
        return Offset((a, b, c, e), NONE.scale if self.scale is None else self.scale)

    def _sure(self, image: Image, other: Image) -> FloatMap:
        """Return the disparity, px, where it is most likely right, 0 elsewhere: what the offset is measured on."""
        if self.model == "classical":
            return match(image, other, self.max_disparity_px)
        most_px = self.max_disparity_px or largest_disparity(quarter_match(image, other), image.shape[1])
        disparity_px, confidence = self._match(image, other, most_px)
        return np.where(confidence > SURE, disparity_px, np.float32(0))

    def _match(self, image: Image, other: Image, max_disparity_px: int) -> tuple[FloatMap, FloatMap]:
        """Return disparity and the error to expect of it, px; of a network, disparity and confidence."""
        if self.model == "classical":
            return classical.estimate(image, other, max_disparity_px)
        from priors.methods._stereo_network import open_network
        from priors.nets.runtime import choose

        chosen = choose(self.runtime, self.weights, self.model, self.size)
        network = open_network(self.model, self.size, chosen, self.weights)
        return network(image, other, max_disparity_px)
