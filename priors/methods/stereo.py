"""Depth from a stereo pair: classical semi-global matching, or a network; with a confidence that is a probability."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np

from eval.calibration import Tolerance
from priors.codecs import FARTHEST_M
from priors.error_model import PIXEL, WITHIN, chance_of, spread_of
from priors.errors import DataError, UsageError, expect, expect_between, expect_choices
from priors.machine import threads
from priors.methods import _stereo_choice
from priors.methods import _stereo_classical as classical
from priors.methods._network import Network
from priors.methods._stereo_size import factor_of
from priors.pairs.matching import largest_disparity, match, quarter_match
from priors.pairs.read import Pair, baseline, find_range, measure_rectification, read_pair
from priors.pairs.rectification import NONE, RectificationError
from priors.pairs.rows import measure_rows, raise_rows
from priors.recalibration import CLASSICAL_STEREO, Recalibration
from priors.sky import doubt, rows_below, sky_mask
from priors.types import Depth, Earlier, FloatMap, Frame, Image, Input, Mask, Method

CALIBRATING_CONFIDENCE = 0.9
"""Confidence of a network's pixels that the rectification error is measured on."""
MOST_ROWS_PX = 100
LARGEST_DISPARITY_PX = 1 << 16
"""No image is that wide; each pair's own width bounds the search further."""


@dataclass(frozen=True)
class Stereo(Method):
    """Match the pair, by hand-made rules or by a network, and tell how far to trust it.

    Every pixel has a value where anything could be matched. The classical confidence is the probability that the depth
    is right within 1 m; a network's is the probability that its disparity is right within 1 px, and 0 beyond 250 m.
    """

    model: Literal["auto", "classical", "cfnet", "pcwnet"] = "classical"
    """classical: semi-global matching, smoothed and filled by what the image says; the others are networks. auto: the
    most accurate that is fast enough here: cfnet on GPUs and on CPUs with tiles, bf16 or VNNI, else classical."""
    size: Literal["s", "m", "l"] = "s"
    """Of a network: small is faster, large is better."""
    runtime: Literal["auto", "bf16", "fp32", "int8", "cuda", "onnx"] = "auto"
    """What runs a network; auto: CUDA where there is one, else what a table says is fastest on this CPU."""
    weights: Path | None = None
    """Your own weights for the network, .safetensors or .onnx; default: those that come with the package."""
    resize: Literal["auto", "fast", "none"] = "auto"
    """At what size a network sees the pair. auto: narrow ones are enlarged to eight tenths of KITTI's width; fast: wide
    ones are seen at 0.85 of their size, for three quarters of the time; none: as it is."""
    max_disparity_px: int | None = None
    """Largest disparity searched; default: what each pair's scene needs."""
    offset_px: tuple[float, ...] | None = None
    """Rectification error of the pair: shift, tilt, yaw and pitch, px. The disparity becomes scale * disparity + shift
    + tilt X + yaw X^2 + pitch X Y, with X = (column - cx) / fx and Y = (row - cy) / fy; numbers that you leave out are
    0. Default: measured, with the scale, against the LiDAR sweep of the drive's first frame; without a LiDAR, what this
    rig's pairs usually have (KITTI), else 0. Give 0 0 0 for depth from the images alone."""
    scale: float | None = None
    """Scale of the disparity, see offset-px. Default: measured with it; 1 where the offset is given."""
    rows_px: float | None = None
    """How many rows the other image lies too low, px, negative where too high: it is shifted back. Default: measured on
    the drive's first pair, and left as it is below 0.75 px."""

    VERSION: ClassVar[int] = 4
    BEFORE: ClassVar[Mapping[str, Any]] = {"rows_px": None, "resize": "none"}

    def __post_init__(self) -> None:
        expect_choices(self, "stereo.")
        expect_between(1, self.max_disparity_px, LARGEST_DISPARITY_PX, "--stereo.max-disparity-px")
        if self.model in ("auto", "classical") and self.weights is not None:
            raise UsageError(f"--stereo.weights {self.weights}: which network is it of? Name it by --stereo.model")
        given = self.offset_px or ()
        expect(len(given) <= 4, "--stereo.offset-px", _words(given), "at most 4 numbers: shift, tilt, yaw, pitch")
        expect(bool(np.isfinite(given).all()), "--stereo.offset-px", _words(given), "finite numbers")
        told = self.rows_px is None or abs(self.rows_px) <= MOST_ROWS_PX
        expect(told, "--stereo.rows-px", self.rows_px, f"from -{MOST_ROWS_PX} to {MOST_ROWS_PX}")
        if self.scale is not None:
            known = self.offset_px is not None and 0.5 < self.scale < 2
            expect(known, "--stereo.scale", self.scale, "about 1, and --stereo.offset-px beside it")

    @property
    def reads(self) -> tuple[Input, ...]:
        """Return what a frame must have."""
        return ("image", "other")

    @property
    def network(self) -> Network | None:
        """Return the network that matches; None for the classical method."""
        model = self.decide_model()
        return None if model == "classical" else Network(model, self.size, self.runtime, self.weights)

    def decide_model(self) -> Literal["classical", "cfnet", "pcwnet"]:
        """Return the model; auto is what suits this machine."""
        return _stereo_choice.choose(self.size) if self.model == "auto" else self.model

    def unread(self) -> Mapping[str, str]:
        """Return the fields that these settings leave without effect: those of a network, of an ONNX file its size."""
        if self.decide_model() == "classical":
            return dict.fromkeys(("size", "runtime", "resize"), "--stereo.model cfnet or pcwnet")
        return dict.fromkeys(("size", "resize"), "weights that are no .onnx") if self._runs_graph else {}

    @property
    def _runs_graph(self) -> bool:
        """Whether the network is an ONNX file of the user's, which takes pairs as they are."""
        return self.weights is not None and self.weights.suffix == ".onnx"

    @property
    def sure_within(self) -> Tolerance:
        """Return what the confidence is the probability of: 1 m, and of a network 1 px."""
        return Tolerance(classical.TOLERANCE_M, "m") if self.network is None else Tolerance(1.0, "px")

    @property
    def rectification(self) -> RectificationError:
        """Return what the matched disparities are corrected by."""
        shift, tilt, yaw, pitch = (*(self.offset_px or ()), *NONE.offset_px)[:4]
        return RectificationError(shift, tilt, yaw, pitch, NONE.scale if self.scale is None else self.scale)

    @property
    def measures(self) -> bool:
        """Tell that the rectification is measured; with a network, this machine also picks the runtime."""
        return self.network is None and self.offset_px is None

    @threads.limited(None)
    def resolve(self, frame: Frame) -> Self:
        """Return the config with the runtime chosen, and the rectification error measured on this frame if not given.

        Where it cannot be measured it is the rig's usual one. UsageError where the image is too narrow for the search.
        """
        width, most_px = frame.camera.size[1], self.max_disparity_px
        fits = most_px is None or most_px < width
        expect(fits, "--stereo.max-disparity-px", most_px, f"less than the image's width, {width} pixels")
        network, model = self.network, self.decide_model()
        if network is None:
            undecided = type(self)()  # size and runtime decide nothing
            resolved = replace(self, model=model, size=undecided.size, runtime=undecided.runtime, resize="none")
        else:
            whole = self._runs_graph or factor_of(width, self.resize) == 1  # then it decides nothing
            resolved = replace(self, model=model, runtime=network.decide(), resize="none" if whole else self.resize)
        resolved = replace(resolved, rows_px=resolved._measure_rows(frame))
        given = self.offset_px is not None
        error = self.rectification if given else measure_rectification(frame, resolved._match_confidently)
        return replace(resolved, offset_px=error.offset_px, scale=error.scale)

    def weights_digest(self) -> str | None:
        """Return the hash of the network's weights, for the cache's key; None for the classical method."""
        return None if self.network is None else self.network.digest()

    def notes(self) -> list[str]:
        """Say what the disparity is corrected by, if it is."""
        error, told = self.rectification, []
        if self.rows_px:
            way = "low" if self.rows_px > 0 else "high"
            told = [
                f"stereo: the other image lies {abs(self.rows_px):.1f} rows too {way}: it is shifted back; "
                "rectify the pair anew (priors check); --stereo.rows-px 0 leaves it as it is"
            ]
        if error == NONE:
            return told
        return [
            *told,
            f"stereo: corrects the pair's rectification error: disparity times {error.scale:.3f}, "
            f"shift {error.shift_px:+.2f} px, tilt {error.tilt_px:+.2f} px, yaw {error.yaw_px:+.2f} px, "
            f"pitch {error.pitch_px:+.2f} px (docs/methods/stereo.md); --stereo.offset-px 0 0 0 leaves it uncorrected",
        ]

    @property
    def carries(self) -> bool:
        """Tell that a map can be moved by the poses and checked against the next frame's pair."""
        return True

    @threads.limited(None)
    def carry_on(self, frame: Frame, before: Earlier) -> Depth | None:
        """Make a frame's map of the frame's before, for less than a third of the time; None where that fails.

        Raises DataError as a whole map does.
        """
        from priors.methods._stereo_carried import carry_on

        fx_baseline = frame.camera.fx * baseline(frame)
        depth = carry_on(frame, self._level(read_pair(frame)), before, self.rectification, fx_baseline)
        if depth is None:
            return None
        depth_m = np.minimum(depth.depth_m, np.float32(FARTHEST_M))
        beyond = (depth.depth_m >= FARTHEST_M) & (self.network is not None)
        return Depth(depth_m, np.where(beyond, np.float32(0), depth.trust()))

    @threads.limited(None)
    def __call__(self, frame: Frame) -> Depth:
        """Make the depth map (height, width), metres along the camera's z axis; the sky's confidence is 0.

        Raises DataError where the pair, its baseline or the network's weights are missing, where the two images differ
        in size, and where left and right are swapped.
        """
        return self.recalibration()(self._as_stated(frame))

    def recalibration(self) -> Recalibration:
        """Return what mends the confidences."""
        return Recalibration.of(CLASSICAL_STEREO) if self.network is None else self.network.recalibration()

    def _as_stated(self, frame: Frame) -> Depth:
        """Make the depth map with the confidences that the matcher states."""
        fx_baseline = frame.camera.fx * baseline(frame)
        pair = self._level(read_pair(frame))
        needed_px = self._search_beyond(find_range(frame, pair))
        sky = sky_mask(pair.left)
        disparity_px, trust = self._match_ground(pair, sky, self.max_disparity_px or needed_px)
        disparity_px, trust = pair.restore(disparity_px), pair.restore(trust)
        matched = disparity_px > 0
        disparity_px = self.rectification.correct(disparity_px, frame.camera)
        least_px = np.float32(fx_baseline / FARTHEST_M)
        beyond = disparity_px <= least_px
        np.maximum(disparity_px, least_px, out=disparity_px)
        depth_m = np.where(matched, np.float32(fx_baseline) / disparity_px, np.float32(0))
        if self.network is None:
            spread = trust / disparity_px
            trust = classical.probability(disparity_px, trust, fx_baseline)
        else:
            matched &= ~beyond  # the disparity of the sky may be right, but its depth is not known
            spread = spread_of(depth_m, trust, PIXEL, fx_baseline)
        relative = chance_of(depth_m, spread, WITHIN)
        trust, relative = (np.where(matched, chance, np.float32(0)) for chance in (trust, relative))
        return doubt(Depth(depth_m, trust, within_5_percent=relative), pair.restore(sky))

    def _search_beyond(self, needed_px: int) -> int:
        """Return how far to search where the scene needs so much, px: a network's header says how far beyond."""
        network = self.network
        if network is None:
            return needed_px
        from priors.methods._stereo_network import open_matcher

        return round(open_matcher(network).headroom * needed_px)

    def _match_ground(self, pair: Pair, sky: Mask, max_disparity_px: int) -> tuple[FloatMap, FloatMap]:
        """Match a pair but for rows that are all sky, which get no disparity. Returns what `_match` does."""
        size, rows = pair.left.shape[:2], rows_below(sky)
        disparity_px, trust = np.zeros(size, np.float32), np.ones(size, np.float32)
        disparity_px[rows], trust[rows] = self._match(pair.left[rows], pair.right[rows], max_disparity_px, sky[rows])
        return disparity_px, trust

    def _match_confidently(self, left: Image, right: Image) -> FloatMap:
        """Return the disparity, px, where it is most likely right, 0 elsewhere: to measure the rectification on."""
        right = right if not self.rows_px else raise_rows(right, self.rows_px)
        if self.network is None:
            return match(left, right, self.max_disparity_px)
        needed_px = largest_disparity(quarter_match(left, right), left.shape[1])
        most_px = self.max_disparity_px or self._search_beyond(needed_px)
        disparity_px, confidence = self._match(left, right, most_px)
        return np.where(confidence > CALIBRATING_CONFIDENCE, disparity_px, np.float32(0))

    def _measure_rows(self, frame: Frame) -> float | None:
        """Return the pair's offset of rows, if it has one that was not given; None where it is as it should be."""
        if self.rows_px is not None or not frame.has("other"):
            return self.rows_px
        try:
            return measure_rows(read_pair(frame))
        except DataError:  # the frame says itself what is wrong with its pair
            return None

    def _level(self, pair: Pair) -> Pair:
        """Return a pair whose rows match."""
        return pair if not self.rows_px else replace(pair, right=raise_rows(pair.right, self.rows_px))

    def _match(
        self, left: Image, right: Image, max_disparity_px: int, sky: Mask | None = None
    ) -> tuple[FloatMap, FloatMap]:
        """Return disparity and the error to expect of it, px; of a network, disparity and confidence."""
        network = self.network
        if network is None:
            return classical.estimate(left, right, max_disparity_px, sky)
        from priors.methods._stereo_network import open_matcher

        factor = 1.0 if self._runs_graph else factor_of(left.shape[1], self.resize)
        return open_matcher(network)(left, right, max_disparity_px, sky, factor)


def _words(numbers: tuple[float, ...]) -> str:
    """Write numbers as they stand on a command line."""
    return " ".join(f"{number:g}" for number in numbers)
