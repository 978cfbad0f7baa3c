"""Protocols: which pixels are scored, and what is done to the prediction before.

The order is fixed: fill (where the protocol does), crop, take the truth's range, align, clamp. Two results are
compared only where their protocols are equal.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt

from eval.depth import FloatArray, Mask, has_value
from eval.errors import DataError

NO_TRUTH = "none"
"""The label of a truth that there is not: images alone are scored."""
KB_ROWS, KB_COLUMNS = 352, 1216
# Top, bottom, left, right as shares of the image, each cut off to whole pixels, as in their authors' code.
FRACTIONS = {
    "garg": (0.40810811, 0.99189189, 0.03594771, 0.96405229),
    "eigen": (0.3324324, 0.91351351, 0.0359477, 0.96405229),
}


class ScoreError(DataError):
    """A score that cannot be made, read or compared."""


@dataclass(frozen=True, slots=True)
class Prepared:
    """One frame, ready to be summed: the crop's pixels, float64."""

    prediction_m: npt.NDArray[np.float64]
    """(height, width), filled, aligned and clamped; 0 = no value."""
    truth_m: npt.NDArray[np.float64]
    """(height, width), 0 where the protocol does not score."""
    own: Mask
    """(height, width), True where the prediction is the method's own, not filled in for it."""
    window: tuple[slice, slice]
    """Rows and columns of the image that were taken."""
    size: tuple[int, ...]
    """(height, width) of the image."""

    def cut(self, confidence: FloatArray) -> FloatArray:
        """Take the same pixels out of the frame's confidence map; ScoreError where it has another size."""
        if confidence.shape != self.size:
            raise ScoreError(f"confidence is {text(confidence.shape)}, truth {text(self.size)}")
        return confidence[self.window]


@dataclass(frozen=True, slots=True)
class Protocol:
    """Everything that must be equal before two figures may stand in one table."""

    name: str
    """What it is called in tables and files."""
    min_m: float = 1e-3
    """Truth at or below this is not scored, metres."""
    max_m: float | None = 80.0
    """Truth at or above this is not scored, metres; None: no cap."""
    crop: Literal["none", "eigen", "garg", "kb"] = "none"
    """Part of the image that is scored."""
    clamp: bool = True
    """Clamp the prediction to [min_m, max_m], after alignment."""
    align: Literal["none", "median", "lsq"] = "none"
    """Fit each frame's prediction to the truth first: a scale by medians, or scale and shift by least squares."""
    missing: Literal["skip", "fill_near", "fill_far"] = "skip"
    """Truth pixels without a prediction: left out (density tells how many), or filled along the row with the nearer
    (KITTI's depth kit) or the farther (its stereo kit) end of the gap."""
    pooling: Literal["image", "pixel"] = "image"
    """Mean of the frames' figures, or one figure over all pixels."""
    truth: str = "annotated"
    """Which truth the figures are against: annotated, lidar, disparity, rendered, ..., or none. A label: two never
    share a table."""
    ranges_m: tuple[float, ...] = (0.0, 10.0, 20.0, 40.0, 80.0)
    """Edges of the breakdown by true distance, metres."""

    def describe(self) -> str:
        """Say in one line what is scored and how."""
        cap = "no cap" if self.max_m is None else f"{self.min_m:g}-{self.max_m:g} m"
        crop = "no crop" if self.crop == "none" else f"{self.crop} crop"
        align = "no alignment" if self.align == "none" else f"{self.align} alignment"
        clamp = "prediction clamped" if self.clamp else "prediction as it is"
        if self.truth == NO_TRUTH:
            return f"{self.name}: images alone, this drive has no true depth"
        pooling = "mean over images" if self.pooling == "image" else "over all pixels"
        missing = "" if self.missing == "skip" else f", gaps {self.missing.replace('_', 'ed ')}"
        return f"{self.name}: {self.truth} truth, {cap}, {crop}, {clamp}{missing}, {align}, {pooling}"

    def bins(self) -> list[tuple[float, float]]:
        """List the breakdown's ranges [from, to), metres; the last is open where truth has no cap."""
        edges = (*self.ranges_m, np.inf) if self.max_m is None else self.ranges_m
        return list(pairwise(edges))

    def prepare(self, prediction_m: FloatArray, truth_m: FloatArray) -> Prepared:
        """Take what is scored out of two maps (height, width), metres.

        Raises:
            ScoreError: the shapes differ, or the image is smaller than the crop.
        """
        if prediction_m.shape != truth_m.shape or truth_m.ndim != 2:
            raise ScoreError(
                f"prediction is {text(prediction_m.shape)}, truth {text(truth_m.shape)}: they must be one size"
            )
        window = crop_window(self.crop, truth_m.shape)
        own = has_value(prediction_m)
        prediction = np.where(own, prediction_m, 0).astype(np.float64)
        if self.missing != "skip":
            prediction = fill_rows(prediction, self.missing)
        prediction, own = prediction[window], own[window]
        truth = np.where(has_value(truth_m), truth_m, 0)[window].astype(np.float64)
        truth[(truth <= self.min_m) | (truth >= (self.max_m or np.inf))] = 0
        prediction = align(prediction, truth, self.align)
        valued = has_value(prediction)
        if self.clamp:
            np.clip(prediction, self.min_m, self.max_m, out=prediction)
        return Prepared(np.where(valued, prediction, 0), truth, own & valued, window, truth_m.shape)


def crop_window(crop: str, size: tuple[int, ...]) -> tuple[slice, slice]:
    """Return the rows and columns a crop keeps of an image of (height, width)."""
    height, width = size
    if crop == "none":
        return slice(0, height), slice(0, width)
    if crop == "kb":  # Uhrig et al.: the bottom rows, the middle columns
        if height < KB_ROWS or width < KB_COLUMNS:
            raise ScoreError(f"crop kb needs at least {KB_ROWS}x{KB_COLUMNS} pixels, found {height}x{width}: use garg")
        left = (width - KB_COLUMNS) // 2
        return slice(height - KB_ROWS, height), slice(left, left + KB_COLUMNS)
    top, bottom, left_share, right = FRACTIONS[crop]
    return slice(int(top * height), int(bottom * height)), slice(int(left_share * width), int(right * width))


def align(prediction_m: npt.NDArray[np.float64], truth_m: FloatArray, how: str) -> npt.NDArray[np.float64]:
    """Fit a prediction to the truth where both have a value; no value stays no value.

    Median: scale = median(truth) / median(prediction) (Zhou et al., CVPR 2017). Least squares: scale and shift that
    minimise the squared error in depth (Ranftl et al., TPAMI 2020, there in disparity); a constant prediction is only
    shifted. What the fit puts at or below 0 has no value any more.
    """
    valued = has_value(prediction_m)
    both = valued & has_value(truth_m)
    if how == "none" or not both.any():
        return prediction_m
    p, t = prediction_m[both], truth_m[both]
    scale, shift = float(np.median(t) / np.median(p)), 0.0
    if how == "lsq":
        centred = p - p.mean()
        spread = float(centred @ centred)
        scale = float(centred @ (t - t.mean())) / spread if spread > 0 else 1.0
        shift = float(t.mean() - scale * p.mean())
    return np.where(valued, scale * prediction_m + shift, 0.0)


def fill_rows(depth_m: npt.NDArray[np.float64], end: Literal["fill_near", "fill_far"]) -> npt.NDArray[np.float64]:
    """Fill gaps as KITTI's evaluation does: along the row, from the gap's nearer or farther end.

    A gap at the image's side takes its one end; empty rows above and below take the first and last row with values.
    An empty row between others stays empty.
    """
    width = depth_m.shape[1]
    valued = has_value(depth_m)
    rows = np.flatnonzero(valued.any(axis=1))
    if not rows.size:
        return depth_m
    column = np.arange(width)
    before = np.maximum.accumulate(np.where(valued, column, -1), axis=1)
    after = np.minimum.accumulate(np.where(valued, column, width)[:, ::-1], axis=1)[:, ::-1]
    padded = np.pad(depth_m, ((0, 0), (1, 1)), constant_values=np.nan)  # column -1 and column width: no end there
    ends = np.take_along_axis(padded, before + 1, axis=1), np.take_along_axis(padded, after + 1, axis=1)
    filled = np.nan_to_num(np.fmax(*ends) if end == "fill_far" else np.fmin(*ends))
    filled[: rows[0]], filled[rows[-1] + 1 :] = filled[rows[0]], filled[rows[-1]]
    return filled


def text(shape: tuple[int, ...]) -> str:
    """Write a shape as people do: 375x1242."""
    return "x".join(map(str, shape))


PRESETS = {
    protocol.name: protocol
    for protocol in (
        Protocol("paper"),
        Protocol("uncapped", min_m=0.0, max_m=None, clamp=False),
        Protocol("eigen", crop="eigen"),
        Protocol("garg", crop="garg"),
        Protocol("kb", crop="kb"),
        Protocol("kitti-completion", min_m=0.0, max_m=None, clamp=False, missing="fill_near"),
        Protocol("stereo2015", min_m=0.0, max_m=None, clamp=False, missing="fill_far", pooling="pixel"),
    )
}


def preset(name: str) -> Protocol:
    """Return the protocol of a name.

    Raises:
        ScoreError: there is none; the names are listed.
    """
    if name not in PRESETS:
        raise ScoreError(f"no protocol {name!r}: choose one of {', '.join(PRESETS)}")
    return PRESETS[name]
