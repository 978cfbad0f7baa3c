"""Curve: what a fit scores at its marks, and what it had spent by then. Kept as JSON beside the fit.

<bench>/<fit>/curve.json    config (what was asked for) and points, written after each
"""

import json
import math
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from eval.files import write_bytes
from nerf.bench.marks import READY, Mark
from nerf.config import FitConfig
from nerf.fields import is_trained
from nerf.split import HELD_OUT
from nerf.study import RunSpec
from priors.records import upgrade

NAME = "curve.json"


@dataclass(frozen=True)
class Entrant:
    """One fit of a bench."""

    spec: RunSpec
    fit: FitConfig
    """Everything but family, depth loss, seed and budget, which `spec` and `marks` say."""
    marks: tuple[Mark, ...]
    """Where it is scored, ascending; its budget ends at the last."""
    variant: str = ""
    """What its settings are called where they are not the usual ones."""

    @classmethod
    def of(cls, spec: RunSpec, fit: FitConfig, marks: tuple[Mark, ...], variant: str = "") -> "Entrant":
        """Make an entrant; one that is not trained is scored once, when it is ready."""
        return cls(spec, fit, marks if is_trained(spec.field) else (READY,), variant)

    @property
    def name(self) -> str:
        """Folder of the fit."""
        last = str(self.marks[-1]).replace(" ", "")
        return "-".join([self.spec.name, *[self.variant] * bool(self.variant), *[last] * (self.marks != (READY,))])

    @property
    def is_ceiling(self) -> bool:
        """Whether it learns the views that it is scored on."""
        return self.spec.views == HELD_OUT

    @property
    def config(self) -> FitConfig:
        """The settings with the budget."""
        return self.fit if self.marks == (READY,) else self.marks[-1].budget(self.fit)


@dataclass(frozen=True)
class Point:
    """What a fit scores at a mark."""

    mark: Mark
    step: int
    """Steps by then."""
    prepared_s: float
    """Wall time before the first step: the model's making, carving. Neither reading the drive nor compiling."""
    trained_s: float
    """Wall time of the steps; not of scoring."""
    processor_s: float
    """Processor time of all threads by then."""
    metrics: dict[str, float] = field(default_factory=dict)
    """Means over the held-out views, as nerf.report has them; NaN: none."""

    @property
    def seconds(self) -> float:
        """All wall time that counts."""
        return self.prepared_s + self.trained_s


@dataclass
class Curve:
    """The points of an entrant, in the order of its marks."""

    entrant: Entrant
    points: list[Point] = field(default_factory=list)
    error: str = ""
    """Why it failed, one line."""

    @property
    def is_done(self) -> bool:
        """Whether no more will come."""
        return bool(self.error) or len(self.points) == len(self.entrant.marks)

    def record(self) -> dict[str, Any]:
        """Return what JSON holds of it: NaN is null."""
        points = [asdict(point) | {"metrics": _as_json(point.metrics)} for point in self.points]
        spec = asdict(self.entrant.spec) | {"prior": self.entrant.spec.prior_name}
        told = {"error": self.error} if self.error else {}
        return {"name": self.entrant.name, "variant": self.entrant.variant, "spec": spec, **told, "points": points}

    def save(self, folder: Path, config: dict[str, Any]) -> None:
        """Write the curve; a kill leaves the one before."""
        content = {"config": config, "points": self.record()["points"]}
        write_bytes(folder / NAME, (json.dumps(content, indent=1, allow_nan=False) + "\n").encode())


def load(folder: Path, entrant: Entrant, config: dict[str, Any]) -> Curve:
    """Return the curve that was made with this config; without points where there is none."""
    try:
        content = json.loads((folder / NAME).read_text(encoding="utf-8"))
        points = [_point(entry) for entry in content["points"]] if _today(content["config"]) == config else []
    except (OSError, ValueError, KeyError, TypeError):
        points = []  # it is made anew
    return Curve(entrant, points)


def _today(config: dict[str, Any]) -> dict[str, Any]:
    """Return what a curve was made with, in the settings of today: a fit may have more of them since."""
    fit = config.get("fit")
    return config | {"fit": upgrade(FitConfig, fit)} if isinstance(fit, dict) else config


def _point(entry: dict[str, Any]) -> Point:
    metrics = {name: math.nan if value is None else float(value) for name, value in entry["metrics"].items()}
    return Point(**entry | {"mark": Mark(**entry["mark"]), "metrics": metrics})


def _as_json(metrics: dict[str, float]) -> dict[str, float | None]:
    return {name: value if math.isfinite(value) else None for name, value in metrics.items()}
