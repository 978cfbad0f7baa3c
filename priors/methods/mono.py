"""Depth from one image: our network, adapted to the drive if asked, or a user's own; aligned to known depth."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from eval.calibration import Tolerance
from priors.errors import DataError, UsageError, expect, expect_choices
from priors.machine import threads
from priors.methods._mono_align import Aligner, Space
from priors.methods._mono_estimator import Estimator, Predict, Prediction, by_drive, by_frame
from priors.methods._mono_size import looks, share_of
from priors.methods._network import Network
from priors.methods._reference import READS, ReferenceDepth
from priors.recalibration import BELIEVED, Recalibration
from priors.resized import Resized
from priors.selection import parse_hold_out, parse_range, select
from priors.types import Camera, Depth, Drive, Frame, Input, Method


@dataclass(frozen=True)
class Mono(Method):
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
    resize: Literal["auto", "none"] = "auto"
    """auto: our network looks at each image twice, at 0.85 and 0.55 of KITTI's size, and takes the mean. A network that
    adapts to the drive looks once, at what has at most KITTI's pixels and 1.5 times its focal length. none: our network
    looks once, at the image as it is."""
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

    VERSION: ClassVar[int] = 3
    """To be raised too where what it learns from or is aligned to changes: the maps of lidar and stereo."""
    BEFORE: ClassVar[Mapping[str, Any]] = {"resize": "none"}

    def __post_init__(self) -> None:
        expect_choices(self, "mono.")
        expect(0 < self.adapt_s < float("inf"), "--mono.adapt-s", self.adapt_s, "seconds, above 0")
        parse_range(self.frames, "--mono.frames")
        parse_hold_out(self.hold_out)
        if self._foreign is not None and self.adapt != "none":
            raise UsageError(
                f"--mono.adapt {self.adapt}: only our own network can adapt, {self.weights} cannot: align it"
            )

    @property
    def _foreign(self) -> Path | None:
        """The user's own network; None where ours is used."""
        return self.weights if self.weights is not None and self.weights.suffix == ".onnx" else None

    @property
    def _needs_drive(self) -> bool:
        """Whether the whole drive is looked at before its first frame."""
        return self.adapt != "none" or (self.align != "none" and self.align_per == "drive")

    @property
    def network(self) -> Network:
        """Return our network."""
        return Network("bts", self.size, self.runtime, self.weights)

    @property
    def reads(self) -> tuple[Input, ...]:
        """Return what a frame must have."""
        if self.align == "none" or self.align_per == "drive" or self.align_to == "auto":
            return ("image",)
        return ("image", *READS[self.align_to])

    @property
    def sure_within(self) -> Tolerance | None:
        """Return what the confidence is the probability of, 1 m; a user's own network has none."""
        return Tolerance(1.0, "m") if self._foreign is None else None

    def unread(self) -> Mapping[str, str]:
        """Return the fields that these settings leave without effect: of adapting, aligning, and our own network."""
        unread: dict[str, str] = {}
        if self._foreign is not None:
            unread |= dict.fromkeys(("size", "runtime", "resize"), "our own network (weights that are no .onnx)")
        if self.adapt == "none":
            unread["adapt_s"] = "--mono.adapt lidar, stereo or video"
        if self.align == "none":
            unread |= dict.fromkeys(("align_to", "align_in", "align_per"), "--mono.align scale or scale-shift")
        if not self._needs_drive:
            how = "--mono.adapt, or by --mono.align with one line for the drive"
            unread |= dict.fromkeys(("hold_out", "frames"), how)
        return unread

    @threads.limited(None)
    def resolve(self, frame: Frame) -> Self:
        """Return the config with every 'auto' decided; what decides nothing is reset, so that it is not in the key."""
        fresh, aligner = type(self)(), self._aligner()
        if aligner is None and self._output() != "metric-depth":
            raise DataError(f"{self.weights}: gives {self._output()}: add --mono.align scale-shift")
        resolved = replace(self, adapt_s=fresh.adapt_s if self.adapt == "none" else self.adapt_s)
        if self._foreign is not None:
            resolved = replace(resolved, size=fresh.size, runtime=fresh.runtime, resize="none")
        else:
            whole = self.adapt != "none" and share_of(frame.camera) == 1  # then it decides nothing
            resize = "none" if whole else self.resize
            resolved = replace(resolved, runtime=self.network.decide_floating(), resize=resize)
        if aligner is None:
            resolved = replace(resolved, align_to=fresh.align_to, align_in=fresh.align_in, align_per=fresh.align_per)
        else:
            source = ReferenceDepth.choose(self.align_to, frame).source
            resolved = replace(resolved, align_to=source, align_in=aligner.space)
        if not resolved._needs_drive:
            return replace(resolved, hold_out=fresh.hold_out, frames=fresh.frames)
        return resolved

    def weights_digest(self) -> str:
        """Return the hash of the weights before adapting, for the cache's key; DataError where there are none."""
        if self._foreign is not None:
            from priors.methods._mono_foreign import digest

            return digest(self._foreign)
        return self.network.digest()

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
        if not self._needs_drive:
            return self
        from priors.adapt.training_frames import training_views

        indices = training_views(len(drive), select(drive.ids, self.frames, "--mono.frames"), self.hold_out)
        network = self.network
        if self.adapt != "none":
            network = self._adapt(self.adapt, drive, indices, folder, on_note)
        predict, mending = self._predict(network), self.recalibration(network)
        aligner = self._aligner()
        if aligner is None:
            return Estimator(predict, recalibration=mending)
        reference = ReferenceDepth.choose(self.align_to, drive[indices[0]])
        if self.align_per == "frame":
            return Estimator(predict, by_frame(aligner, reference), mending)
        return Estimator(predict, by_drive(aligner, reference, predict, drive, indices, on_note), mending)

    @threads.limited(None)
    def __call__(self, frame: Frame) -> Depth:
        """Make the depth map (height, width), metres along the camera's z axis; no value in the sky.

        Raises DataError where the weights are missing, and where the config needs the whole drive (see prepare).
        """
        if self._needs_drive:
            raise DataError("mono: adapting, or aligning once for the drive, needs the drive: call prepare first")
        aligner = self._aligner()
        predict, mending = self._predict(self.network), self.recalibration(self.network)
        if aligner is None:
            return Estimator(predict, recalibration=mending)(frame)
        return Estimator(predict, by_frame(aligner, ReferenceDepth.choose(self.align_to, frame)), mending)(frame)

    def recalibration(self, network: Network | None = None) -> Recalibration:
        """Return what mends the confidences of a network, this config's if none is given; a user's own has none."""
        return BELIEVED if self._foreign is not None else (network or self.network).recalibration()

    def _output(self) -> str:
        """Return what the network gives: metric-depth, relative-depth or disparity."""
        if self._foreign is None:
            return "metric-depth"
        from priors.methods._mono_description import describe

        return describe(self._foreign).output

    def _aligner(self) -> Aligner | None:
        """Return what fits lines; None where nothing is aligned."""
        if self.align == "none":
            return None
        gives: Space = "disparity" if self._output() == "disparity" else "depth"
        return Aligner(self.align, gives if self.align_in == "auto" else self.align_in, gives)

    def _predict(self, network: Network) -> Predict:
        """Return what says depth of an image: the user's own network where there is one, else this one."""
        if self._foreign is not None:
            from priors.methods._mono_foreign import open_foreign

            foreign = open_foreign(self._foreign)
            return lambda image, camera: Prediction(foreign(image, camera), None)
        from priors.methods._mono_network import estimate

        net = network.open()
        return lambda image, camera: estimate(net, image, camera, self._shares(camera))

    def _shares(self, camera: Camera) -> tuple[float, ...]:
        """Return the shares of an image's sides at which our network looks at it: what adapts to a drive looks once."""
        if self.resize == "none":
            return (1.0,)
        return looks(camera) if self.adapt == "none" else (share_of(camera),)

    def _adapt(
        self,
        how: Literal["lidar", "stereo", "video"],
        drive: Drive,
        indices: list[int],
        folder: Path,
        on_note: Callable[[str], None],
    ) -> Network:
        """Return our network with weights that were adapted to these frames of a drive."""
        from priors.adapt.finetune import AdaptConfig
        from priors.methods._mono_network import adapted_weights
        from priors.methods._mono_supervision import by_depth, by_video

        (share,) = self._shares(drive[indices[0]].camera)
        seen = drive if share == 1 else Resized(drive, share)
        if how == "video":
            planned = by_video(seen, indices)
        else:
            planned = by_depth(seen, indices, ReferenceDepth.choose(how, seen[indices[0]]))
        if share < 1:
            planned = replace(planned, decides=planned.decides | {"share": round(share, 6)})
        config = AdaptConfig(seconds=self.adapt_s, lr=planned.lr)
        return replace(self.network, weights=adapted_weights(drive, planned, self.network, config, folder, on_note))
