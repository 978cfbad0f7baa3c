"""Fits under stress: faults of inputs and settings that a fit must survive, each with a stated answer.

    a prior of another scale, a prior of which 30 % is ten times too far
        -> as good as the right prior, within LOST_DB and TIMES_ABS_REL: the check before a fit finds the fault
    a black training frame
        -> as good as without that frame, within the same
    ten seeds at ten times the learning rate
        -> a model of finite numbers, or a one-line refusal; never a picture of NaN

A fit is a few hundred steps, enough for a fault to show.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from nerf.config import FitConfig, ModelConfig
from nerf.evidence.check import check
from nerf.finite import NotFiniteError
from nerf.optimise import OptimiserConfig
from nerf.scene import Scene
from nerf.stress import spoilt
from nerf.stress.held_out import fitted
from nerf.truths import Truths

LOST_DB, TIMES_ABS_REL, MORE_ABS_REL = 1.0, 1.2, 0.005
"""How much worse than the fit that it is compared with one may be: dB of PSNR, and AbsRel, times and beside."""
SEEDS, TIMES_RATE = 10, 10.0
RATES = ("grid", "network", "sky", "alignment")
ALIKE = f"within {LOST_DB} dB and {TIMES_ABS_REL} times the AbsRel of: "
FINITE = "finite numbers, or refused in one line"


@dataclass(frozen=True)
class Case:
    """A fit, and what it must come to."""

    name: str
    stated: str
    """The stated answer; empty for a fit that others are compared with."""
    spoil: Callable[[Scene], Scene] = lambda scene: scene
    change: Callable[[FitConfig], FitConfig] = lambda config: config
    like: "Case | None" = None
    """Another case, made before, that it must come close to."""


@dataclass(frozen=True)
class Row:
    """What came of a case."""

    case: str
    psnr: float
    """dB; NaN where the fit was refused."""
    abs_rel: float
    """NaN where it was refused, or there is no truth."""
    stated: str
    fault: str = ""
    """What is wrong with it; empty where it is as stated."""
    told: str = ""
    """The line of a refusal."""

    def record(self) -> dict[str, Any]:
        """Return the row as JSON holds it."""
        figures = {"psnr": self.psnr, "abs_rel": self.abs_rel}
        known = {name: None if math.isnan(value) else value for name, value in figures.items()}
        return {"case": self.case, **known, "stated": self.stated, "fault": self.fault, "told": self.told}


def faster(seed: int) -> Callable[[FitConfig], FitConfig]:
    """Return what gives a fit a seed and TIMES_RATE times the usual learning rates."""
    usual = OptimiserConfig()
    rates = {name: TIMES_RATE * getattr(usual, name) for name in RATES}
    return lambda config: replace(config, seed=seed, optimiser=replace(config.optimiser, **rates))


def alike(other: Case, name: str, spoil: Callable[[Scene], Scene]) -> Case:
    """Return a case with a faulty scene that must come close to another case."""
    return Case(name, ALIKE + other.name, spoil, like=other)


RIGHT = Case("right prior", "")
FEWER = Case("right prior, a training frame less", "", spoilt.without_a_frame)
CASES: tuple[Case, ...] = (
    RIGHT,
    alike(RIGHT, "prior half as far", spoilt.scaled(0.5)),
    alike(RIGHT, "prior twice as far", spoilt.scaled(2.0)),
    alike(RIGHT, "30 % of the prior ten times too far, at random", spoilt.at_random),
    alike(RIGHT, "30 % of the prior ten times too far, in squares", spoilt.in_blobs),
    FEWER,
    alike(FEWER, "a black training frame", spoilt.with_a_black_frame),
    *(Case(f"ten times the learning rate, seed {seed}", FINITE, change=faster(seed)) for seed in range(SEEDS)),
)


def run(
    scene: Scene,
    truths: Truths,
    config: FitConfig,
    cases: Sequence[Case] = CASES,
    on_row: Callable[[Row], None] = lambda row: None,
) -> list[Row]:
    """Make the fits, one after the other; those that others are compared with are made, too.

    Args:
        scene: with a right prior.
        truths: the depth of its held-out views.
        config: the fits' settings: family, steps.
        cases: which fits.
        on_row: told each row.
    """
    rows: dict[str, Row] = {}
    for case in (each for asked in cases for each in (asked.like, asked) if each is not None):
        if case.name not in rows:
            other = None if case.like is None else rows[case.like.name]
            rows[case.name] = _row(case, other, _figures(case, scene, truths, config))
            on_row(rows[case.name])
    return list(rows.values())


def config_of(family: str, steps: int) -> FitConfig:
    """Return the settings of a fit under stress."""
    return FitConfig(ModelConfig(family), steps=steps, seconds=None)


def _figures(case: Case, scene: Scene, truths: Truths, config: FitConfig) -> tuple[float, float] | str:
    """Return PSNR, dB, and AbsRel of a case's fit, or the line in which it was refused."""
    try:
        return fitted(check(case.spoil(scene)).scene, truths, case.change(config))
    except NotFiniteError as error:
        return str(error)


def _row(case: Case, other: Row | None, found: tuple[float, float] | str) -> Row:
    """Judge a case by what is stated of it."""
    if isinstance(found, str):
        fault = "" if case.stated == FINITE else "refused"
        return Row(case.name, math.nan, math.nan, case.stated, fault, found)
    psnr, abs_rel = found
    fault = ""
    if not math.isfinite(psnr):
        fault = "numbers that are not finite"
    elif other is not None:
        lost_db = other.psnr - psnr
        most = TIMES_ABS_REL * other.abs_rel + MORE_ABS_REL
        if lost_db > LOST_DB:
            fault = f"{lost_db:.2f} dB lost"
        elif abs_rel > most:
            fault = f"AbsRel {abs_rel:.4f}, more than {most:.4f}"
    return Row(case.name, psnr, abs_rel, case.stated, fault)
