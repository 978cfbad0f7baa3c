"""Depth from one image: our network, adapted to the drive if asked, or a user's own; aligned to what is known."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal, Self

import numpy as np

from priors.codecs import FARTHEST_M
from priors.errors import DataError
from priors.machine import threads
from priors.methods import _mono_align
from priors.methods._mono_align import Alignment
from priors.types import Camera, Depth, Drive, FloatMap, Frame, Image

if TYPE_CHECKING:
    from priors.methods._reference import Known
    from priors.nets.runtime import Floating

TOLERANCE_M = 1.0
MOST_ALIGNED = 12
Predict = Callable[[Image, Camera], tuple[FloatMap, FloatMap | None]]
"""Image and camera -> values (height, width), 0 = none, and the expected error of their logarithm where known."""


@dataclass(frozen=True)
class Mono:
    """Estimate depth from each image alone; the camera's intrinsics tell the scale.

    The network can first be adapted to the drive, for a bounded time, by what the frames that are not held out know.
    The confidence is the probability that the depth is right within 1 m; a user's network has none.
    """

    weights: Path | None = None
    """Your own weights of our network (.safetensors), or any network as .onnx with a description beside it
    (docs/methods/mono.md); default: those that come with the package."""
    size: Literal["s", "m", "l"] = "m"
    """Of our network: small is faster, large is better."""
    runtime: Literal["auto", "bf16", "fp32", "cuda", "onnx"] = "auto"
    """What runs our network; auto: CUDA where there is one, else what a table says is fastest on this CPU."""
    adapt: Literal["none", "lidar", "stereo", "video"] = "none"
    """Fine-tune our network on this drive first: on each training frame's own sweep, where its stereo is sure, or so
    that posed training frames explain each other."""
    adapt_s: float = 75.0
    """How long to fine-tune, seconds. The result is kept beside the cache: a second run does not adapt again."""
    align: Literal["none", "scale", "scale-shift"] = "none"
    """Fit a scale, or scale and shift, to known depth."""
    align_to: Literal["auto", "lidar", "sparse", "stereo"] = "auto"
    """Known depth to align to; auto: the first of LiDAR, the data set's sparse maps, stereo that the drive has."""
    align_in: Literal["auto", "depth", "disparity"] = "auto"
    """Where the line is fitted; auto: disparity for networks that give disparity, else depth."""
    align_per: Literal["frame", "drive"] = "drive"
    """One line for the drive, from frames that are not held out; or one a frame, from its own known depth."""
    hold_out: str = "9::10"
    """Frames that adapting and a drive's alignment never see, start:stop:step over `frames`; none: all take part.
    Default: every 10th from the 10th on, those that `nerf fit` holds out."""
    frames: str | None = None
    """Range a:b of the frames to adapt and align on, as --frames; hold_out counts inside it. Default: the whole drive,
    whatever --frames says."""

    VERSION: ClassVar[int] = 1
    """To be raised too where what it learns from or is aligned to changes: the maps of lidar and stereo."""

    def __post_init__(self) -> None:
        if not 0 < self.adapt_s < float("inf"):
            raise DataError(f"mono: adapt-s is {self.adapt_s}, expected seconds above 0")
        if self._foreign and self.adapt != "none":
            raise DataError(
                f"--mono.adapt {self.adapt}: only our own network can adapt, {self.weights} cannot: align it"
            )

    @property
    def _foreign(self) -> bool:
        return self.weights is not None and self.weights.suffix == ".onnx"

    @property
    def reads(self) -> tuple[str, ...]:
        """Return what a frame must have."""
        from priors.methods._reference import READS

        per_frame = self.align != "none" and self.align_per == "frame"
        return ("image", *(READS.get(self.align_to, ()) if per_frame else ()))

    @threads.limited(None)
    def resolve(self, frame: Frame) -> Self:
        """Return the config with every 'auto' decided; what decides nothing is reset, so that it is not in the key."""
        fresh = type(self)()
        known = self._known(self.align_to, frame).source if self.align != "none" else fresh.align_to
        output = self._output()
        if output != "metric-depth" and self.align == "none":
            raise DataError(f"{self.weights}: gives {output}: add --mono.align scale-shift")
        space: Literal["depth", "disparity"] = "disparity" if output == "disparity" else "depth"
        resolved = replace(
            self,
            size=fresh.size if self._foreign else self.size,
            runtime=fresh.runtime if self._foreign else self._choose_runtime(),
            adapt_s=fresh.adapt_s if self.adapt == "none" else self.adapt_s,
            align_to=known,
            align_in=(space if self.align_in == "auto" else self.align_in) if self.align != "none" else fresh.align_in,
            align_per=self.align_per if self.align != "none" else fresh.align_per,
        )
        if resolved.adapt == "none" and (resolved.align == "none" or resolved.align_per == "frame"):
            return replace(resolved, hold_out=fresh.hold_out, frames=fresh.frames)
        return resolved

    def weights_digest(self) -> str:
        """Return the hash of the weights before adapting, for the cache's key; DataError where there are none."""
        if self._foreign and self.weights is not None:
            from priors.methods._mono_foreign import digest

            return digest(self.weights)
        from priors.nets import weights

        return weights.digest(weights.find("bts", self.size, self.weights))

    def prepare(
        self, drive: Drive, folder: Path, on_note: Callable[[str], None] = lambda line: None
    ) -> Callable[[Frame], Depth]:
        """Adapt and align once for a drive; returns what makes a frame's depth.

        Args:
            drive: what the frames come from. Those held out are not read.
            folder: where adapted weights are kept.
            on_note: told what is going on, a line at a time.

        Raises DataError where weights, or what adapting and aligning need, are missing.
        """
        if self.adapt == "none" and (self.align == "none" or self.align_per == "frame"):
            return self
        from priors.adapt.selection import MOST_VIEWS, pick_evenly, training_views
        from priors.build import select

        chosen = select(drive.ids, self.frames)
        indices = training_views(len(drive), chosen, self.hold_out)
        predict = self._adapted(drive, indices, folder, on_note) if self.adapt != "none" else self._predict()
        if self.align == "none":
            return lambda frame: self._finish(predict, frame)
        known = self._known(self.align_to, drive[indices[0]])
        if self.align_per == "frame":
            return lambda frame: self._finish(predict, frame, known=known)
        few = pick_evenly(indices, MOST_VIEWS)
        picked = [drive[index] for index in few[:: max(1, len(few) // MOST_ALIGNED)]]
        samples = [(predict(frame.image(), frame.camera)[0], known(frame)) for frame in picked]
        line = self._fit(samples, f"{drive.name}, {len(picked)} frames")
        on_note(f"mono: one line for the drive, in {line.space}: scale {line.scale:.4g}, shift {line.shift:.4g}")
        return lambda frame: self._finish(predict, frame, line)

    @threads.limited(None)
    def __call__(self, frame: Frame) -> Depth:
        """Make the depth map (height, width), metres along the camera's z axis; no value in the sky.

        Raises DataError where the weights are missing, and where the config needs the whole drive (see prepare).
        """
        if self.adapt != "none" or (self.align != "none" and self.align_per == "drive"):
            raise DataError("mono: adapting, or aligning once for the drive, needs the drive: call prepare first")
        known = None if self.align == "none" else self._known(self.align_to, frame)
        return self._finish(self._predict(), frame, known=known)

    def _choose_runtime(self) -> "Floating":
        from priors.nets import runtime

        return runtime.choose_floating(self.runtime, net="bts")

    def _output(self) -> str:
        """Return what the network gives: metric-depth, relative-depth or disparity."""
        if not self._foreign or self.weights is None:
            return "metric-depth"
        from priors.methods._mono_foreign import describe

        return describe(self.weights).output

    @staticmethod
    def _known(source: str, frame: Frame) -> "Known":
        from priors.methods._reference import Known

        return Known.choose(source, frame)

    def _predict(self, file: Path | None = None) -> Predict:
        if self._foreign and self.weights is not None:
            from priors.methods._mono_foreign import open_foreign

            foreign = open_foreign(self.weights)
            return lambda image, camera: (foreign(image, camera), None)
        from priors.methods._mono_network import estimate, open_network

        ready = open_network(self.size, self._choose_runtime(), file or self.weights)
        return lambda image, camera: estimate(ready, image, camera)

    def _adapted(self, drive: Drive, indices: list[int], folder: Path, on_note: Callable[[str], None]) -> Predict:
        from priors.adapt.finetune import AdaptConfig
        from priors.methods._mono_network import adapted_weights
        from priors.methods._mono_supervision import by_depth, by_video
        from priors.nets import weights

        start = weights.find("bts", self.size, self.weights)
        if self.adapt == "video":
            lesson = by_video(drive, indices)
        else:
            lesson = by_depth(drive, indices, self._known(self.adapt, drive[indices[0]]))
        config, chosen = AdaptConfig(seconds=self.adapt_s, lr=lesson.lr), self._choose_runtime()
        return self._predict(adapted_weights(drive, lesson, start, self.size, config, folder, on_note, chosen))

    def _fit(self, samples: list[tuple[FloatMap, FloatMap]], what: str) -> Alignment:
        """Fit one line to all the frames' values and known depth."""
        assert self.align != "none" and self.align_in != "auto"
        there = [known_m > 0 for _, known_m in samples]
        values = [self._in_space(values)[t] for (values, _), t in zip(samples, there, strict=True)]
        known_m = [known_m[t] for (_, known_m), t in zip(samples, there, strict=True)]
        try:
            return _mono_align.fit(np.concatenate(values), np.concatenate(known_m), self.align, self.align_in)
        except DataError as error:
            raise DataError(f"{what}: {error}") from error

    def _in_space(self, values: FloatMap) -> FloatMap:
        """Turn the network's values into the space of the line: depth into disparity or back."""
        if (self._output() == "disparity") == (self.align_in == "disparity"):
            return values
        with np.errstate(divide="ignore"):
            return np.where(values > 0, 1 / values, np.float32(0)).astype(np.float32)

    def _finish(
        self, predict: Predict, frame: Frame, line: Alignment | None = None, known: "Known | None" = None
    ) -> Depth:
        """Make a frame's depth, aligned by a line or, where `known` is given, by the frame's own."""
        values, error = predict(frame.image(), frame.camera)
        if known is not None:
            line = self._fit([(values, known(frame))], f"frame {frame.id}")
        depth_m = values if line is None else line.apply(self._in_space(values))
        depth_m = np.minimum(depth_m, np.float32(FARTHEST_M))
        if error is None:
            return Depth(depth_m)
        with np.errstate(divide="ignore"):
            sure = -np.expm1(-np.float32(TOLERANCE_M) / (depth_m * error))
        return Depth(depth_m, np.where(depth_m > 0, sure, np.float32(0)).astype(np.float32))
