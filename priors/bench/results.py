"""Results of a bench, as JSON: what is there, measured in the same way, is not measured again.

<cache>/<drive>/bench/bench.json    asked (what must be equal for two figures to compare) and the standings
                     /bench.md      the table, and what was typed
                     /bench.svg .png  error against time
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import median
from typing import Any, Self

import numpy as np

from eval.files import write_bytes
from priors.bench.front import Worth
from priors.errors import DataError

FORMAT = 1
FOLDER, NAME = "bench", "bench.json"


@dataclass(frozen=True)
class Trial:
    """One map that was made."""

    frame: str
    seconds: float
    """Wall time, as a build has it: what the method reads is in it."""
    read_s: float
    """Of it, reading the frame's files."""
    processor_s: float
    """Processor time of all threads."""
    metrics: dict[str, float] = field(default_factory=dict)
    """As Judge.metrics has them."""


@dataclass
class Standing:
    """What is known of an entrant."""

    name: str
    family: str
    kind: str
    method: str
    config: dict[str, Any]
    """Of the method, with 'auto' as it was asked."""
    identity: str
    peak_gib: float = math.nan
    """Largest resident memory of a process of its own."""
    cold_s: float = 0.0
    """Seconds of the first map of a process."""
    warm_s: float = 0.0
    """Seconds of its second."""
    trials: list[Trial] = field(default_factory=list)
    error: str = ""
    """Why it does not take part, one line."""

    @property
    def seconds(self) -> float:
        """Median wall time of a frame; NaN without trials."""
        return self._median("seconds")

    @property
    def spread_s(self) -> float:
        """Half of the range from the first quartile to the third."""
        times = [trial.seconds for trial in self.trials]
        return float(np.subtract(*np.percentile(times, [75, 25]))) / 2 if times else math.nan

    def figures(self) -> dict[str, float]:
        """Return what a row of the table shows: times in ms, memory in GiB, the metrics' means over frames."""
        times = {"ms": self.seconds, "spread_ms": self.spread_s}
        times |= {"processor_ms": self._median("processor_s"), "read_ms": self._median("read_s")}
        return {name: 1e3 * value for name, value in times.items()} | {"peak_gib": self.peak_gib} | self.metrics()

    def metrics(self) -> dict[str, float]:
        """Return the mean of each metric over the frames that have it."""
        keys = dict.fromkeys(key for trial in self.trials for key in trial.metrics)
        found = {key: [trial.metrics[key] for trial in self.trials if key in trial.metrics] for key in keys}
        numbers = {key: [value for value in values if math.isfinite(value)] for key, values in found.items()}
        return {key: math.fsum(values) / len(values) if values else math.nan for key, values in numbers.items()}

    def worth(self, error: str = "abs_rel") -> Worth:
        """Return what the front compares, as exact as the table prints it: a runtime's rounding wins nothing."""
        metrics = self.metrics()
        return Worth(self.seconds, round(metrics.get(error, math.nan), 4), round(metrics.get("density", 0.0), 3))

    def _median(self, name: str) -> float:
        return median(getattr(trial, name) for trial in self.trials) if self.trials else math.nan


@dataclass(frozen=True)
class Bench:
    """What was measured on a drive's frames."""

    asked: dict[str, Any]
    """Drive, calibration, frames, protocol and machine: two benches compare where it is equal."""
    standings: tuple[Standing, ...]
    command: str = ""
    busy: float = math.nan
    """Load of the machine for each core when it began; NaN: not known."""

    def beside(self, others: Mapping[str, Standing]) -> Self:
        """Return it with the standings, by identity, of who did not take part this time."""
        own = {standing.identity for standing in self.standings}
        more = tuple(standing for identity, standing in others.items() if identity not in own)
        return replace(self, standings=(*self.standings, *more))

    def save(self, folder: Path) -> None:
        """Write it, atomically."""
        standings = [
            asdict(standing)
            | {"peak_gib": _number(standing.peak_gib)}
            | {"trials": [asdict(trial) | {"metrics": _plain(trial.metrics)} for trial in standing.trials]}
            for standing in self.standings
        ]
        content = {"format": FORMAT, "command": self.command, "busy": _number(self.busy), "asked": self.asked}
        text = json.dumps(content | {"standings": standings}, indent=1, allow_nan=False)
        write_bytes(folder / NAME, (text + "\n").encode())

    @classmethod
    def load(cls, folder: Path) -> Self:
        """Read a bench; DataError where there is none, or it is damaged or of another format."""
        path = folder / NAME
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            if content["format"] != FORMAT:
                raise DataError(f"{path}: a bench of format {content['format']}, expected {FORMAT}: make it again")
            standings = tuple(map(_standing, content["standings"]))
            return cls(content["asked"], standings, str(content["command"]), _nan(content["busy"]))
        except OSError as error:
            raise DataError(f"{path}: cannot be read ({error.strerror}): make it by `priors bench`") from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise DataError(f"{path}: damaged, or no bench: delete it and run `priors bench` again") from error


def earlier(folder: Path, asked: dict[str, Any]) -> dict[str, Standing]:
    """Return what an earlier bench measured in the same way, by identity; nothing where it was asked otherwise."""
    try:
        bench = Bench.load(folder)
    except DataError:
        return {}
    same = bench.asked == json.loads(json.dumps(asked))
    return {standing.identity: standing for standing in bench.standings if not standing.error} if same else {}


def of_drive(home: Path, fingerprint: str) -> Bench | None:
    """Return the bench of a drive's folder in a cache; None where there is none of this drive."""
    try:
        bench = Bench.load(home / FOLDER)
    except DataError:
        return None
    return bench if bench.asked.get("fingerprint") == fingerprint else None


def measured(standings: Sequence[Standing]) -> list[Standing]:
    """Return those that have trials, the fastest first."""
    return sorted((each for each in standings if each.trials), key=lambda each: each.seconds)


def _standing(entry: dict[str, Any]) -> Standing:
    trials = [
        Trial(**trial | {"metrics": {k: _nan(v) for k, v in trial["metrics"].items()}}) for trial in entry["trials"]
    ]
    return Standing(**entry | {"trials": trials, "peak_gib": _nan(entry["peak_gib"])})


def _plain(metrics: dict[str, float]) -> dict[str, float | None]:
    return {name: _number(value) for name, value in metrics.items()}


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _nan(value: float | None) -> float:
    return math.nan if value is None else float(value)
