"""Candidates: what each method of ours would take on a drive, and how right it would be, before it is built.

The drive's own bench tells it where there is one (`priors bench`); else the shipped table, scaled to this machine.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from priors import methods
from priors.bench import searched, shipped
from priors.bench.entrants import AUTO, Entrant, field_size
from priors.bench.probe import calibrate
from priors.bench.results import Bench, Standing, measured, of_drive
from priors.machine import cpu, threads
from priors.records import restore
from priors.types import Drive, Frame, Method

DENSE = 0.5
"""Share of an image that a map must have values for, to be chosen where nobody names its method: skies take a third."""
OWN, SHIPPED = "measured on this drive", "predicted from the shipped table"


@dataclass(frozen=True)
class Candidate:
    """A method with its settings, and what to expect of it."""

    name: str
    """As the bench has it."""
    method: Method
    """As it is asked for: 'auto' is not decided."""
    seconds: float
    """Of a frame."""
    abs_rel: float
    """NaN where nobody scored it."""
    density: float
    """Share of the image's pixels with a value."""
    source: str
    """OWN or SHIPPED."""

    @property
    def changes(self) -> dict[str, Any]:
        """Return the settings that are not the method's usual ones."""
        own, usual = vars(self.method), vars(type(self.method)())
        return {field.name: own[field.name] for field in fields(self.method) if own[field.name] != usual[field.name]}

    @property
    def dense(self) -> bool:
        """Whether its maps are dense."""
        return self.density >= DENSE

    def flags(self) -> list[str]:
        """Return what a user types for it."""
        settings = (f"--{self.method.name}.{name.replace('_', '-')} {value}" for name, value in self.changes.items())
        return [f"--method {self.method.name}", *settings]


def candidates(drive: Drive, frame: Frame, cache: Path) -> list[Candidate]:
    """List what can be built of a drive, the fastest first.

    Args:
        drive: the drive.
        frame: one of its frames: what that has, methods can read.
        cache: where the drive's bench may lie. Without one, the machine is calibrated for two seconds.
    """
    bench = of_drive(cache / drive.name, drive.fingerprint())
    found = [] if bench is None else _measured(bench)
    if not found:
        found = _predicted(drive, frame)
    return sorted((each for each in found if _lacks(each, frame) is None), key=lambda each: each.seconds)


def _measured(bench: Bench) -> list[Candidate]:
    """Return those of a bench that were timed and scored, where it was made on a machine like this one."""
    machine = bench.asked["machine"]
    alike = (machine["cpu"], machine["cores"]) == (cpu.mode(), threads.available())
    if not alike or bench.asked["protocol"] is None:
        return []
    return [_candidate(standing) for standing in measured(bench.standings) if standing.kind == "method"]


def _candidate(standing: Standing) -> Candidate:
    method = restore(methods.config_type(standing.method), standing.config)
    metrics, nan = standing.metrics(), float("nan")
    error, density = metrics.get("abs_rel", nan), metrics.get("density_image", nan)
    return Candidate(standing.name, method, standing.seconds, error, density, OWN)


def _predicted(drive: Drive, frame: Frame) -> list[Candidate]:
    """Return those of the shipped table, for this image's size, the drive's disparities and this machine."""
    height, width = frame.camera.size
    times_ms = shipped.times_ms(cpu.mode(), height * width, calibrate(), searched.usual(drive))
    errors = shipped.errors()
    if frame.has("sparse"):  # the table's completion fills what the lidar method makes; here that is there already
        times_ms |= {name: ms - times_ms["lidar"] for name, ms in times_ms.items() if name.startswith("completion")}
    return [
        Candidate(each.name, each.method, 1e-3 * times_ms[each.name], told["abs_rel"], told["density_image"], SHIPPED)
        for each in field_size([AUTO])
        if each.name in times_ms and (told := errors.get(each.name)) is not None
    ]


def _lacks(candidate: Candidate, frame: Frame) -> str | None:
    return Entrant(candidate.name, candidate.method).lacks(frame)


def most_accurate(among: Sequence[Candidate]) -> Candidate | None:
    """Return the one with the least error; of equals the fastest; None where none was scored."""
    scored = [each for each in among if each.abs_rel == each.abs_rel]
    return min(scored, key=lambda each: (round(each.abs_rel, 4), each.seconds), default=None)
