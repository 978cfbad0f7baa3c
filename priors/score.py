"""Scores: the maps of a prior against a drive's truth; the result is kept as metrics.json beside the maps.

From Python:

    prior = cache.only(Path("cache/DRIVE/stereo-KEY"))
    score(prior).result.metrics()["abs_rel"]

`priors eval` does the same for each prior, and prints a table.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from eval.curves import Curves, Metric, ScoredPixels, best, curves, join
from eval.protocol import Protocol, preset
from eval.result import FLICKER, Comparison, Result
from eval.result import score as score_frames
from priors import drives
from priors.cache import Prior
from priors.cache.store import publish
from priors.errors import DataError
from priors.flicker import flicker_of
from priors.machine import threads
from priors.naming import labels
from priors.selection import select
from priors.types import Drive, Frame

PAPER = preset("paper")


OnFrame = Callable[[str], None]
Scorer = Callable[["Pairs", Protocol, dict[str, Any], OnFrame], Result]
"""Scores all pairs by a protocol; the result has the info that is given, and each frame's id is told."""


@dataclass(frozen=True)
class Pairs:
    """The maps of a prior and what they are scored against, paired by frame id; read when they are asked for."""

    prior: Prior
    drive: Drive
    ids: list[str]
    """Frames that have both a map and a truth."""
    against: Prior | None = None
    """Another prior in place of the drive's truth."""
    left_out: dict[str, str] = field(default_factory=dict)
    """Frame id -> why it cannot be scored; known once the pairs were read."""
    scorer: Scorer | None = None
    """Scores elsewhere (priors/scale/scoring.py); it keeps no pixels. None: here."""

    def __len__(self) -> int:
        return len(self.ids)

    def __iter__(self) -> Iterator[Comparison]:
        places = {id_: index for index, id_ in enumerate(self.drive.ids)}
        for id_ in self.ids:
            try:
                depth, frame = self.prior.read(id_), self.drive[places[id_]]
                truth = frame.truth() if self.against is None else self.against.read(id_)
                foreground = frame.foreground() if self.against is None and frame.has("foreground") else None
                if depth.depth_m.shape != truth.depth_m.shape:
                    shapes = f"the map is {depth.depth_m.shape}, the truth {truth.depth_m.shape}"
                    raise DataError(
                        f"{self.prior.depth_path(id_)}: {shapes}: take other truth (--truth), or build again"
                    )
            except DataError as error:
                self.left_out[id_] = str(error)
                continue
            yield Comparison(id_, depth.depth_m, depth.confidence, truth.depth_m, fx_baseline_of(frame), foreground)
        if len(self.left_out) == len(self.ids):
            first = next(iter(self.left_out))
            raise DataError(f"{self.prior.folder}: no frame can be scored, the first {first}: {self.left_out[first]}")

    @property
    def fx_baseline(self) -> float | None:
        """Return focal length times baseline, px m, for disparity metrics; None without a pair, or if frames differ."""
        return None if drives.is_by_frame(self.drive.describe()) else fx_baseline_of(self.drive[0])


@dataclass(frozen=True)
class Score:
    """What one prior scores."""

    result: Result
    pixels: ScoredPixels | None
    """The scored pixels of all frames, where they were to be kept and the prior has a confidence."""
    fx_baseline: float | None
    """As in Pairs."""
    unsaved: str | None = None
    """Why metrics.json could not be written."""

    def curves(self) -> list[Curves]:
        """Return the sparsification curves of AbsRel, RMSE and, for pairs, D1; none where no pixels were kept."""
        if self.pixels is None:
            return []
        metrics: tuple[Metric, ...] = ("abs_rel", "rmse") if self.fx_baseline is None else ("abs_rel", "rmse", "d1")
        return [curves(self.pixels, metric, self.fx_baseline) for metric in metrics]

    def most_confident(self, share: float) -> dict[str, float]:
        """Return the figures over this share of the pixels, the most confident ones; none where none were kept."""
        return {} if self.pixels is None else best(self.pixels, share, fx_baseline=self.fx_baseline)

    def nearest(self, share: float) -> dict[str, float]:
        """Return the figures over this share of the pixels, those predicted nearest: that needs no confidence."""
        if self.pixels is None:
            return {}
        pixels = replace(self.pixels, confidence=-self.pixels.prediction_m)
        return best(pixels, share, fx_baseline=self.fx_baseline)


def pair(prior: Prior, drive: Drive, frames: str | None = None, against: Prior | None = None) -> Pairs:
    """Find the frames of a prior that can be scored.

    Args:
        prior: whose maps.
        drive: the one that the prior was made for.
        frames: only this range of frames, a:b.
        against: another prior in place of the drive's truth.

    Raises DataError where there is no map, or no truth for any.
    """
    places = {drive.ids[index]: index for index in select(drive.ids, frames)}
    cached = [id_ for id_ in prior.ids() if id_ in places]
    if not cached:
        asked = "" if frames is None else f" in --frames {frames}"
        raise DataError(f"{prior.folder}: no maps of {drive.name}{asked}: build them first")
    if against is not None:
        ids = [id_ for id_ in cached if against.has(id_)]
        if not ids:
            raise DataError(f"{against.folder}: has none of the {len(cached)} frames of {prior.folder}: build them")
        return Pairs(prior, drive, ids, against)
    ids = [id_ for id_ in cached if drive[places[id_]].has("truth")]
    if not ids:
        drive[places[cached[0]]].truth()  # raises with the drive's own reason
    return Pairs(prior, drive, ids)


def score_pairs(
    pairs: Pairs,
    protocol: Protocol = PAPER,
    name: str | None = None,
    keep_pixels: bool = False,
    on_frame: OnFrame = lambda frame_id: None,
    temporal: bool = False,
) -> Score:
    """Score the maps of a prior and keep the result as metrics.json beside them.

    Args:
        pairs: from `pair`.
        protocol: which pixels count, and how.
        name: what to call the prior in tables; default: its method and what is unusual about it.
        keep_pixels: whether to keep the scored pixels of a prior with a confidence; curves are made of them. They take
            24 bytes a pixel.
        on_frame: told the id of each frame when it is scored.
        temporal: whether to measure the flicker too, see priors/flicker.py.
    """
    prior = pairs.prior
    truth = drives.truth_of(pairs.drive.describe()) if pairs.against is None else pairs.against.name
    if truth is not None:
        protocol = replace(protocol, truth=truth)
    info = {"prior": labels([prior])[0] if name is None else name, "drive": pairs.drive.name, "folder": prior.name}
    parts: list[ScoredPixels] = []
    kept = keep_pixels and (prior.folder / "confidence").is_dir()
    with threads.limited(threads.count()):
        if pairs.scorer is not None and not kept:
            result = pairs.scorer(pairs, protocol, info, on_frame)
        else:
            told = _telling(pairs, on_frame)
            result = score_frames(told, protocol, pairs.fx_baseline, info, parts.append if kept else None)
        if temporal:
            value = flicker_of(prior, pairs.drive, pairs.ids, pairs.against)
            result = replace(result, info={**result.info, FLICKER: value})
    unsaved = None
    try:
        result.save(prior.folder / "metrics.json")
        publish(prior.folder / "metrics.json")
    except OSError as error:  # a cache of somebody else, or a full disk: the figures are told all the same
        unsaved = f"{prior.folder / 'metrics.json'}: cannot be written ({error.strerror})"
    return Score(result, join(parts) if kept else None, pairs.fx_baseline, unsaved)


def score(
    prior: Prior,
    drive: Drive | None = None,
    protocol: Protocol = PAPER,
    frames: str | None = None,
    against: Prior | None = None,
    keep_pixels: bool = False,
) -> Score:
    """Score a prior: `pair`, then `score_pairs`. The drive is, if not given, opened as the prior's manifest says."""
    drive = drives.reopen(prior.drive) if drive is None else drive
    return score_pairs(pair(prior, drive, frames, against), protocol, keep_pixels=keep_pixels)


def fx_baseline_of(frame: Frame) -> float | None:
    """Return a frame's focal length times baseline, px m; None where it has no pair."""
    return None if frame.baseline_m is None else frame.camera.fx * frame.baseline_m


def _telling(pairs: Pairs, on_frame: Callable[[str], None]) -> Iterator[Comparison]:
    for comparison in pairs:
        yield comparison
        on_frame(comparison.frame)
