"""Measured: the figures of a study's runs, by what they are in the study."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nerf.paper import numbers
from nerf.paper.plan import ABLATED, Plan
from nerf.report import Report
from nerf.study import NONE, Outcome, RunSpec

SSIM = {"ngp": "ssim_gauss11"}
"""Which SSIM the study takes of a field; of others the uniform one."""
LPIPS = ("lpips_vgg", "lpips_squeeze")
"""The study's first."""


@dataclass(frozen=True)
class Measured:
    """What the runs of a plan have come to, means over seeds."""

    plan: Plan
    outcomes: Sequence[Outcome]

    def reports(self, spec: RunSpec) -> list[Report]:
        """Return the reports of a run, one a seed."""
        own = replace(spec, seed=0)
        return [each.report for each in self.outcomes if each.report is not None and replace(each.spec, seed=0) == own]

    def figure(self, spec: RunSpec | None, key: str) -> float | None:
        """Return a figure's mean over seeds; None where nothing was run, or not all seeds have it."""
        rows = [report.metrics() for report in self.reports(spec)] if spec is not None else []
        values = [row[key] for row in rows if np.isfinite(row.get(key, np.nan))]
        return float(np.mean(values)) if values and len(values) == len(rows) else None

    def spread_db(self, spec: RunSpec) -> float:
        """Return the standard deviation of the PSNR over seeds; 0 of one."""
        values = [report.metrics()["psnr"] for report in self.reports(spec)]
        return float(np.std(values, ddof=1)) if len(values) > 1 else 0.0

    def row(self, spec: RunSpec | None) -> dict[str, float | None]:
        """Return the figures that the study prints, by its names."""
        key = "ssim_uniform7" if spec is None else SSIM.get(spec.field, "ssim_uniform7")
        lpips = next((self.figure(spec, name) for name in LPIPS if self.figure(spec, name) is not None), None)
        named = {"psnr": "psnr", "ssim": key, "rmse": "rmse", "abs_rel": "abs_rel"}
        found = {name: self.figure(spec, own) for name, own in named.items()}
        return {name: lpips if name == "lpips" else found[name] for name in numbers.Row._fields}

    def spec(self, role: str, field: str = ABLATED, views: str = "sparse", **choices: Any) -> RunSpec | None:
        """Return the run of a prior's role with some choices; None where the plan has no such prior."""
        prior = self.plan.prior(role)
        if prior is None:
            return None
        loss = None if prior == NONE else "mse"
        return RunSpec(field, views, prior, **{"loss": loss, **choices})

    def psnr(self, role: str, field: str = ABLATED, views: str = "sparse", **choices: Any) -> float | None:
        """Return the PSNR of such a run, dB; None where it was not made."""
        return self.figure(self.spec(role, field, views, **choices), "psnr")

    def abs_rel(self, role: str, field: str = ABLATED, views: str = "sparse", **choices: Any) -> float | None:
        """Return the AbsRel of such a run; None where it was not made."""
        return self.figure(self.spec(role, field, views, **choices), "abs_rel")

    def missing(self) -> list[RunSpec]:
        """List the runs of the plan that have no figures."""
        made = {each.spec for each in self.outcomes if each.report is not None}
        return [spec for spec in self.plan.runs() if spec not in made]
