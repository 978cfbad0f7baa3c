"""Ablation: each switch that skips work, off alone: what it saves, and what it changes, at equal steps and equal time.

A switch is a setting that leaves something out or puts work where it counts. Off is what a fit without it does. A
change is the switch's: on less off, so that a positive PSNR says that the switch helps.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from eval import typeset
from eval.typeset import Column, Table
from nerf import fields
from nerf.bench.curve import Curve, Entrant, Point
from nerf.bench.marks import Mark
from nerf.config import FitConfig
from nerf.study import NONE, RunSpec
from nerf.study_table import prior_labels
from nerf.volumetric import VolumetricFamily

ALL = "all"
"""The variant that has every switch off."""
OFF = "without "
"""Stands before a switch's name in a variant's."""


@dataclass(frozen=True)
class Switch:
    """One setting, and how a fit is without it."""

    name: str
    off: Callable[[FitConfig], FitConfig]
    samples: bool = True
    """Whether it is one of sampling rays, which only volumetric families do."""
    of_prior: bool = False
    """Whether it does something only where there is a prior."""
    of_proposals: bool = False
    """Whether only families with proposals have it."""


def _sampler(**changes: Any) -> Callable[[FitConfig], FitConfig]:
    def off(fit: FitConfig) -> FitConfig:
        return replace(fit, model=replace(fit.model, sampler=replace(fit.model.sampler, **changes)))

    return off


def _losses(**changes: Any) -> Callable[[FitConfig], FitConfig]:
    return lambda fit: replace(fit, losses=replace(fit.losses, **changes))


SWITCHES = (
    Switch("guide", _sampler(guide=False), of_prior=True),
    Switch("carve", _sampler(carve=False), of_prior=True),
    Switch("carve_sky", _sampler(carve_sky=False)),
    Switch("terminate", _sampler(terminate=0.0)),
    Switch("roulette_samples", _sampler(roulette_samples=1.0)),
    Switch("roulette_proposals", _sampler(roulette_proposals=1.0), of_proposals=True),
    Switch("proposals_every", _sampler(proposals_every=1), of_proposals=True),
    Switch("roulette_rays", _sampler(roulette_rays=1.0)),
    Switch("sky_opacity", _losses(sky_opacity=0.0), samples=False),
    Switch("trim", _losses(trim=0.0), samples=False, of_prior=True),
    Switch("align", lambda fit: replace(fit, align="none"), samples=False, of_prior=True),
)


def ablated(spec: RunSpec, fit: FitConfig, marks: tuple[Mark, ...]) -> list[Entrant]:
    """List the fits of an ablation: as it is, without each switch that is on and has an effect, and without all."""
    entrants = [Entrant.of(spec, fit, marks)]
    if not fields.is_trained(spec.field):
        return entrants
    bare = fit
    for switch in _of(spec):
        off = switch.off(fit)
        bare = switch.off(bare)
        if off != fit:
            entrants.append(Entrant.of(spec, off, marks, OFF + switch.name))
    return [*entrants, Entrant.of(spec, bare, marks, OFF + ALL)] if len(entrants) > 2 else entrants


def _of(spec: RunSpec) -> list[Switch]:
    """List the switches that a fit's family and prior have."""
    family = fields.family(spec.field)
    volumetric = isinstance(family, VolumetricFamily)
    proposals = bool(getattr(family, "proposals", ()))
    return [
        each
        for each in SWITCHES
        if (volumetric or not each.samples)
        and (proposals or not each.of_proposals)
        and (spec.prior != NONE or not each.of_prior)
    ]


COLUMNS = {
    "saves": Column("time", "x", higher=True, digits=2),
    "psnr": Column("PSNR", "dB", higher=True, digits=2),
    "abs_rel": Column("AbsRel", digits=4),
    "psnr_time": Column("PSNR", "dB, equal time", higher=True, digits=2),
    "abs_rel_time": Column("AbsRel", "equal time", digits=4),
}
"""What a row shows of a switch. Time: processor time of a step without it, over that with it. PSNR, AbsRel: with less
without it, after as many steps, and when the fit without it has spent as much processor time."""


def lay_out(curves: Sequence[Curve], caption: str = "") -> Table:
    """Lay out a row a switch: means over seeds."""
    specs = list(dict.fromkeys(replace(curve.entrant.spec, seed=0) for curve in curves))
    labels = prior_labels(specs)
    rows = []
    for spec in specs:
        own = [curve for curve in curves if replace(curve.entrant.spec, seed=0) == spec and curve.is_done]
        for variant in dict.fromkeys(curve.entrant.variant for curve in own if curve.entrant.variant):
            pairs = _pairs(own, variant)
            if pairs:
                changes = [change(on, off) for on, off in pairs]
                means = {key: float(np.mean([each[key] for each in changes])) for key in COLUMNS}
                rows.append(((spec.field, labels[spec.prior], spec.views, variant.removeprefix(OFF)), means))
    notes = [
        "a switch on, less the same fit without it: time is that of a step without it over one with it",
        "equal time: the fit without it when it had spent as much processor time, its learning rate not yet at its end",
    ]
    return typeset.lay_out(("field", "prior", "views", "switch"), COLUMNS, rows, caption, notes, group=3)


def change(on: Curve, off: Curve) -> dict[str, float]:
    """Return what a switch changes: `on` is the fit with it, `off` the one without, both to the same marks."""
    last, other = on.points[-1], off.points[-1]
    told = {"saves": (other.processor_s / other.step) / (last.processor_s / last.step)}
    for key in ("psnr", "abs_rel"):
        told[key] = last.metrics.get(key, math.nan) - other.metrics.get(key, math.nan)
        told[f"{key}_time"] = last.metrics.get(key, math.nan) - at_time(off.points, key, last.processor_s)
    return told


def at_time(points: Sequence[Point], key: str, processor_s: float) -> float:
    """Return a figure of a fit when it had spent this processor time, between its marks; NaN before and after them."""
    times = [point.processor_s for point in points]
    values = [point.metrics.get(key, math.nan) for point in points]
    return float(np.interp(processor_s, times, values, left=math.nan, right=math.nan))


def _pairs(curves: Sequence[Curve], variant: str) -> list[tuple[Curve, Curve]]:
    """Return the fits with a switch and without it, by seed."""
    usual = {curve.entrant.spec.seed: curve for curve in curves if not curve.entrant.variant and curve.points}
    return [
        (usual[curve.entrant.spec.seed], curve)
        for curve in curves
        if curve.entrant.variant == variant and curve.points and curve.entrant.spec.seed in usual
    ]
