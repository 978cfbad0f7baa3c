"""Results: one row of sums a frame, and the figures made from them; kept in a metrics.json.

The file, version 1: what was scored (info), the protocol, the figures for reading (metrics, ranges, and each frame's)
and each frame's sums. Only protocol, info and sums are read back; NaN is written as null.
"""

import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self

import numpy as np

from eval.curves import ScoredPixels, curves, scored_pixels
from eval.depth import DepthSums, FloatArray, Mask
from eval.files import write_bytes
from eval.protocol import Protocol, ScoreError
from eval.stereo import DisparitySums

FORMAT = 1
GROUNDS = ("bg", "fg")
"""Background and foreground of KITTI's stereo benchmark, and of its names for their outliers: d1_bg, d1_fg."""
FLICKER = "flicker"
"""Entry of a result's info: how much the depth of a point differs from frame to frame, where that was measured."""
Pooling = Literal["image", "pixel"]


class Comparison(NamedTuple):
    """One frame's prediction and truth, as they were made; the maps are (height, width)."""

    frame: str
    """Id; where a result spans drives, with the drive's name before it."""
    prediction_m: FloatArray
    confidence: FloatArray | None
    """Higher is more trusted; None where the method states none."""
    truth_m: FloatArray
    fx_baseline: float | None = None
    """Focal length times baseline of the frame, px m, where the frames' cameras differ; else see `score`."""
    foreground: Mask | None = None
    """Pixels of objects that move by themselves, where the truth tells them apart."""


@dataclass(frozen=True, slots=True)
class Row:
    """One frame's sums."""

    frame: str
    """As in Comparison."""
    depth: DepthSums
    disparity: DisparitySums | None
    """None where fx * baseline is not known."""
    ranges: tuple[DepthSums, ...]
    """The depth sums of each range of true distance; their pixels are the truth's."""
    ause: dict[str, float] = field(default_factory=dict)
    """Area under the sparsification error (see eval.curves) of ause_abs_rel and ause_rmse; empty: no confidence."""
    grounds: dict[str, DisparitySums] = field(default_factory=dict)
    """The disparity sums of the background (bg) and of the foreground (fg); empty where nobody tells them apart."""

    def metrics(self) -> dict[str, float]:
        """Return the frame's figures."""
        return figures([self], "pixel")


@dataclass(frozen=True, slots=True)
class Result:
    """What one prior scores on any number of frames."""

    protocol: Protocol
    rows: tuple[Row, ...] = ()
    info: dict[str, Any] = field(default_factory=dict)
    """What was scored; `prior` names it in tables. Anything JSON holds."""

    @property
    def name(self) -> str:
        """Name of the prior in a table."""
        return str(self.info.get("prior", "prior"))

    @property
    def sums(self) -> DepthSums:
        """Return the depth sums over all frames."""
        return reduce(add, (row.depth for row in self.rows), DepthSums())

    def metrics(self, pooling: Pooling | None = None) -> dict[str, float]:
        """Return all figures, pooled as the protocol says unless told otherwise; the flicker is the whole result's."""
        measured = self.info.get(FLICKER)
        between = {FLICKER: float(measured)} if isinstance(measured, int | float) else {}
        return figures(self.rows, pooling or self.protocol.pooling) | between

    def by_range(self, pooling: Pooling | None = None) -> list[tuple[tuple[float, float], dict[str, float]]]:
        """Return the depth figures of each range [from, to), metres."""
        return [
            (
                edges,
                figures(
                    [Row(row.frame, row.ranges[i], None, ()) for row in self.rows], pooling or self.protocol.pooling
                ),
            )
            for i, edges in enumerate(self.protocol.bins())
        ]

    def __add__(self, other: "Result") -> "Result":
        """Join the frames of two results of one prior.

        Raises:
            ScoreError: the protocols differ, or a frame is in both.
        """
        refuse_to_mix([self, other])
        twice = {row.frame for row in self.rows} & {row.frame for row in other.rows}
        if twice:
            raise ScoreError(f"frame {min(twice)} is in both results of {self.name}: merge each frame once")
        info = {name: value for name, value in self.info.items() if name != FLICKER}  # of these frames alone
        return Result(self.protocol, self.rows + other.rows, info)

    def save(self, path: Path) -> None:
        """Write the result as JSON, atomically."""
        ranges = [
            {"from_m": low, "to_m": None if math.isinf(high) else high, "metrics": metrics}
            for (low, high), metrics in self.by_range()
        ]
        content = {
            "format": FORMAT,
            "info": self.info,
            "protocol": asdict(self.protocol),
            "metrics": {"image": self.metrics("image"), "pixel": self.metrics("pixel")},
            "ranges": ranges,
            "frames": [asdict(row) | {"metrics": row.metrics()} for row in self.rows],
        }
        text = json.dumps(_without_nan(content), indent=1, allow_nan=False) + "\n"
        write_bytes(path, text.encode())

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a result.

        Raises:
            ScoreError: the file is missing, damaged or of another format.
        """
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            if content["format"] != FORMAT:
                raise ScoreError(f"{path}: metrics of format {content['format']}, expected {FORMAT}: score again")
            ranges_m = tuple(content["protocol"].pop("ranges_m"))
            protocol = Protocol(**content["protocol"], ranges_m=ranges_m)
            return cls(protocol, tuple(map(_read_row, content["frames"])), content["info"])
        except OSError as error:
            raise ScoreError(f"{path}: cannot be read ({error.strerror}): score first") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ScoreError(f"{path}: expected a metrics file, found damaged or other data: score again") from error


def score(
    frames: Iterable[Comparison],
    protocol: Protocol,
    fx_baseline: float | None = None,
    info: dict[str, Any] | None = None,
    on_pixels: Callable[[ScoredPixels], None] | None = None,
) -> Result:
    """Score frames one at a time: memory does not grow with their number.

    Args:
        frames: the maps of each frame; a generator that reads a frame when it is asked for keeps memory small.
        protocol: which pixels are scored, and how.
        fx_baseline: focal length times baseline, px m, for the disparity metrics; None leaves them out.
        info: what is scored; `prior` is its name in tables.
        on_pixels: gets the scored pixels of each frame.

    Raises:
        ScoreError: a frame's maps differ in size or do not fit the crop.
    """
    rows = tuple(score_frame(Comparison(*frame), protocol, fx_baseline, on_pixels) for frame in frames)
    return Result(protocol, rows, info or {})


def score_frame(
    frame: Comparison,
    protocol: Protocol,
    fx_baseline: float | None = None,
    on_pixels: Callable[[ScoredPixels], None] | None = None,
) -> Row:
    """Score one frame; see `score`."""
    ause: dict[str, float] = {}
    try:
        ready = protocol.prepare(frame.prediction_m, frame.truth_m)
        if frame.confidence is not None or on_pixels is not None:
            pixels = scored_pixels(ready, frame.confidence)
            ause = {} if frame.confidence is None else _ause(pixels)
            if on_pixels is not None:
                on_pixels(pixels)
    except ScoreError as error:
        raise ScoreError(f"frame {frame.frame}: {error}") from error
    true = ready.truth_m > 0  # a fifth of the image: the rest only counts for density_image
    p, t, own = ready.prediction_m[true], ready.truth_m[true], ready.own[true]
    fx_baseline = fx_baseline if frame.fx_baseline is None else frame.fx_baseline
    grounds: dict[str, DisparitySums] = {}
    if fx_baseline is not None and frame.foreground is not None:
        front = frame.foreground[ready.window][true]
        sides = {"bg": ~front, "fg": front}
        grounds = {name: DisparitySums.over_depths(p[side], t[side], fx_baseline) for name, side in sides.items()}
    parts = [(t >= low) & (t < high) for low, high in protocol.bins()]
    return Row(
        frame.frame,
        replace(DepthSums.over(p, t, own), pixels=ready.own.size, values=int(np.count_nonzero(ready.own))),
        None if fx_baseline is None else DisparitySums.over_depths(p, t, fx_baseline),
        tuple(DepthSums.over(p[part], t[part], own[part]) for part in parts),
        ause,
        grounds,
    )


def figures(rows: Sequence[Row], pooling: Pooling) -> dict[str, float]:
    """Make the figures of rows: the mean of each row's, or one over all pixels.

    A row without a figure (nothing to average) does not count in that figure's mean. AUSE is a mean over rows always.
    """
    if pooling == "image":
        return _mean([row.metrics() for row in rows] or [figures([], "pixel")])
    pooled = reduce(add, (row.depth for row in rows), DepthSums()).finish()
    disparity = [row.disparity for row in rows if row.disparity is not None]
    if disparity:
        pooled |= reduce(add, disparity).finish()
    for name in GROUNDS:
        sides = [row.grounds[name] for row in rows if name in row.grounds]
        if sides:
            pooled[f"d1_{name}"] = reduce(add, sides).finish()["d1"]
    return pooled | _mean([row.ause for row in rows if row.ause])


def refuse_to_mix(results: Sequence[Result]) -> None:
    """Raise ScoreError where results were made by different protocols."""
    for result in results[1:]:
        ours, theirs = results[0].protocol, result.protocol
        if ours != theirs:
            raise ScoreError(
                f"{results[0].name} and {result.name} were scored by different protocols "
                f"({ours.describe()} | {theirs.describe()}): score both by one"
            )


def _ause(pixels: ScoredPixels) -> dict[str, float]:
    return {f"ause_{metric}": curves(pixels, metric).ause for metric in ("abs_rel", "rmse")}


def _mean(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    """Average each key over the rows that have a number for it."""
    columns = {key: [row[key] for row in rows if key in row] for row in rows for key in row}
    numbers = {key: [value for value in values if not math.isnan(value)] for key, values in columns.items()}
    return {key: math.fsum(values) / len(values) if values else math.nan for key, values in numbers.items()}


def _read_row(entry: dict[str, Any]) -> Row:
    disparity = entry["disparity"]
    return Row(
        entry["frame"],
        DepthSums(**entry["depth"]),
        None if disparity is None else DisparitySums(**disparity),
        tuple(DepthSums(**part) for part in entry["ranges"]),
        {key: math.nan if value is None else value for key, value in entry["ause"].items()},
        {name: DisparitySums(**sums) for name, sums in entry.get("grounds", {}).items()},
    )


def _without_nan(value: Any) -> Any:
    """Replace NaN by None, however deep."""
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
