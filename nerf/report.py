"""Report of a run: its field's held-out views scored, pictured, and kept.

    <run>/metrics.json           figures, pooled and of each frame (format below)
         /depth.json             the depth figures as `priors eval` writes them: a row for its tables
         /renders/...            nerf.pictures
         /renders/scores.jsonl   one line a scored frame: what a killed report goes on from

metrics.json, version 1: `info` (what was run), `protocol`, `truth`, `metrics` (for reading: NaN is null, infinity
"inf") and `frames` (sums and errors: what is read back).
"""

import json
import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from eval.depth import DepthSums
from eval.files import write_bytes
from eval.image import ImageScore, mean
from eval.lpips import HOW_TO_GET, Lpips
from eval.protocol import Protocol, ScoreError, preset
from eval.result import Comparison, Result, Row, score_frame
from nerf.pictures import KEPT, picture_path, save_error, save_view
from nerf.scene import Scene
from nerf.truths import Truths
from nerf.types import Render
from priors import codecs
from priors.errors import DataError
from priors.types import Image

FORMAT = 1
DEPTH_KEYS = ("rmse", "abs_rel", "delta_1", "mae", "density")
Step = Callable[[], None]


@dataclass(frozen=True)
class FrameScore:
    """What one held-out view scores."""

    frame: str
    image: ImageScore
    depth: Row | None
    """Of the expected depth; None without a truth."""
    median: Row | None
    """Of the median depth."""
    seconds: float
    """Time to render."""

    def figures(self) -> dict[str, float]:
        """Return the view's figures; those of the median depth are named median_*."""
        depth = {} if self.depth is None else self.depth.metrics()
        median = {} if self.median is None else self.median.metrics()
        return {
            **self.image.figures(),
            **{key: depth.get(key, math.nan) for key in DEPTH_KEYS},
            **{f"median_{key}": median.get(key, math.nan) for key in DEPTH_KEYS},
            "render_s": self.seconds,
        }


@dataclass(frozen=True)
class Report:
    """What a run scores on its held-out views."""

    protocol: Protocol
    frames: tuple[FrameScore, ...]
    info: dict[str, Any]
    """What was run; `name` and `config` among it. Anything JSON holds."""
    remarks: tuple[str, ...] = ()
    """Figures that are absent, and why; whose images took part in the poses. One line each."""

    def metrics(self) -> dict[str, float]:
        """Return every figure's mean over the views; views without a figure do not count in it."""
        rows = [frame.figures() for frame in self.frames]
        image = mean([frame.image for frame in self.frames])
        keys = [key for key in (rows[0] if rows else {}) if key not in image and not key.startswith("lpips_")]
        columns = {key: [row[key] for row in rows if not math.isnan(row[key])] for key in keys}
        return image | {key: math.fsum(values) / len(values) if values else math.nan for key, values in columns.items()}

    def depth(self) -> Result:
        """Return the expected depth's figures as `eval` keeps them."""
        rows = tuple(frame.depth for frame in self.frames if frame.depth is not None)
        return Result(self.protocol, rows, {"prior": self.info.get("name", "field"), **self.info})

    def save(self, folder: Path) -> None:
        """Write metrics.json, and depth.json where there is a true depth, each atomically."""
        content = {
            "format": FORMAT,
            "info": self.info,
            "protocol": asdict(self.protocol),
            "remarks": self.remarks,
            "metrics": self.metrics(),
            "frames": [asdict(frame) | {"metrics": frame.figures()} for frame in self.frames],
        }
        if self.depth().rows:
            self.depth().save(folder / "depth.json")
        write_bytes(folder / "metrics.json", (json.dumps(_as_json(content), indent=1, allow_nan=False) + "\n").encode())

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a metrics.json.

        Raises:
            DataError: it is missing, damaged or of another format.
        """
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            if content["format"] != FORMAT:
                raise DataError(f"{path}: metrics of format {content['format']}, expected {FORMAT}: run nerf eval")
            protocol = Protocol(**content["protocol"] | {"ranges_m": tuple(content["protocol"]["ranges_m"])})
            return cls(protocol, tuple(map(_frame, content["frames"])), content["info"], tuple(content["remarks"]))
        except OSError as error:
            raise DataError(f"{path}: cannot be read ({error.strerror}): run nerf eval") from error
        except (ValueError, KeyError, TypeError) as error:
            if isinstance(error, DataError):
                raise
            raise DataError(f"{path}: expected a run's metrics, found damaged or other data: run nerf eval") from error


@dataclass(frozen=True)
class Subject:
    """What is scored."""

    render: Render
    """Renders the field."""
    checkpoint: str
    """What tells this field from others: a hash of its weights."""
    info: dict[str, Any]
    """What was run; see Report."""
    remarks: tuple[str, ...] = ()
    """What must be known beside the figures, one line each."""


@dataclass(frozen=True)
class Scoring:
    """How it is scored."""

    lpips: Lpips | None = None
    """None leaves that figure out."""
    protocol: str = "paper"
    """A preset of eval.protocol for the depth."""


def report(
    scene: Scene,
    truths: Truths,
    subject: Subject,
    folder: Path,
    scoring: Scoring | None = None,
    on_frame: Step = lambda: None,
) -> Report:
    """Render and score the scene's held-out views, and write all files of a run's report.

    Frames that this checkpoint has rendered already are not rendered again; an LPIPS that they lack is added.

    Args:
        scene: whose held-out frames are scored.
        truths: the drive's true depths.
        subject: the field.
        folder: the run's folder.
        scoring: how it is scored.
        on_frame: called after each frame.

    Raises:
        DataError: there is no held-out frame, or a render is damaged (NaN).
    """
    if not scene.test:
        raise DataError(f"{scene.name}: none of the {len(scene.ids)} frames is held out: take 10 frames or more")
    scoring = scoring or Scoring()
    rules = replace(preset(scoring.protocol), truth=truths.label)
    scorer = _Scorer(scene, truths, subject, folder / "renders", scoring.lpips, rules)
    before = scorer.before()
    frames = []
    for position in scene.test:
        frames.append(scorer.score(position, before.get(scene.ids[position])))
        on_frame()
    lacking = () if scoring.lpips is not None or all(frame.image.lpips for frame in frames) else (HOW_TO_GET,)
    remarks = (*subject.remarks, *((truths.why_none,) if truths.why_none else ()), *lacking)
    result = Report(rules, tuple(frames), subject.info, remarks)
    result.save(folder)
    return result


@dataclass(frozen=True)
class _Scorer:
    """Scores views one by one, and keeps each score in renders/scores.jsonl as soon as it is there."""

    scene: Scene
    truths: Truths
    subject: Subject
    renders: Path
    lpips: Lpips | None
    rules: Protocol

    @property
    def key(self) -> str:
        """What a score depends on: checkpoint and protocol."""
        return f"{self.subject.checkpoint}/{self.rules.describe()}"

    def before(self) -> dict[str, FrameScore]:
        """Return the frames that were scored under this key and whose pictures are all there."""
        path = self.renders / "scores.jsonl"
        scores = {}
        for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
            try:
                line = json.loads(text)
                if line["key"] == self.key:
                    scores[line["frame"]] = _frame(line)
            except (ValueError, KeyError, TypeError):
                continue  # cut off by a kill
        there = {id_: all(picture_path(self.renders, kind, id_).exists() for kind in KEPT) for id_ in scores}
        return {id_: score for id_, score in scores.items() if there[id_]}

    def score(self, position: int, before: FrameScore | None) -> FrameScore:
        """Score a view, or add what its score of before lacks."""
        id_, image = self.scene.ids[position], np.asarray(self.scene.images[position])
        score = before or self._render(position, image)
        if self.lpips is not None and self.lpips.net not in score.image.lpips:
            rgb = codecs.read_image(picture_path(self.renders, "rgb", id_))
            lpips = score.image.lpips | {self.lpips.net: self.lpips(rgb, image)}
            score = replace(score, image=replace(score.image, lpips=lpips))
        if score is not before:
            self._keep(score)
        return score

    def _render(self, position: int, image: Image) -> FrameScore:
        """Render a view, write its pictures and score it."""
        id_, truth = self.scene.ids[position], self.truths(self.scene.ids[position])
        start = time.perf_counter()
        view = self.subject.render(self.scene.T_world_cam[position], self.scene.camera)
        seconds = time.perf_counter() - start
        try:
            score = ImageScore.over(view.rgb, image)
            rows = [
                None if truth is None else score_frame(Comparison(id_, depth_m, None, truth.depth_m), self.rules)
                for depth_m in (view.depth_m, view.median_m)
            ]
        except ScoreError as error:
            raise DataError(f"{self.scene.name}: frame {id_}: {error}") from error
        save_view(self.renders, id_, view)
        save_error(self.renders, id_, view, image, truth)
        return FrameScore(id_, score, rows[0], rows[1], seconds)

    def _keep(self, score: FrameScore) -> None:
        """Append a frame's line; on a line of its own even where the last one was cut off."""
        path = self.renders / "scores.jsonl"
        cut_off = path.exists() and path.read_bytes()[-1:] not in (b"", b"\n")
        line = json.dumps({"key": self.key, **asdict(score)}) + "\n"
        with path.open("a", encoding="utf-8") as file:
            file.write("\n" + line if cut_off else line)


def _frame(entry: dict[str, Any]) -> FrameScore:
    """Read what asdict made of a frame's score; other keys are ignored."""
    depth, median = _row(entry["depth"]), _row(entry["median"])
    return FrameScore(entry["frame"], ImageScore(**entry["image"]), depth, median, entry["seconds"])


def _row(entry: dict[str, Any] | None) -> Row | None:
    if entry is None:
        return None
    return Row(entry["frame"], DepthSums(**entry["depth"]), None, tuple(DepthSums(**part) for part in entry["ranges"]))


def _as_json(value: Any) -> Any:
    """Make what JSON holds of figures, however deep: NaN is null, infinity "inf"."""
    if isinstance(value, dict):
        return {key: _as_json(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_as_json(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value
