"""Plan: every run of the study on one drive, as one list. `nerf study --preset paper` makes it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from nerf.guide import TRUTH
from nerf.paper import numbers
from nerf.study import NONE, RunSpec, Study
from priors import cache
from priors.errors import UsageError

Change: TypeAlias = tuple[str | None, dict[str, Any]]
"""A prior, and what is unusual about a run with it."""
FEW_VIEWS = ("1/8", "1/16")
DENSITIES = (0.05, 0.1, 0.2, 0.4)
"""Shares of a prior's values: the study's curve rises until 20 % and is stable from 40 % on."""
CONFIDENT = 0.5
"""A value that is more often right than wrong is kept."""
ABLATED = "mip360"
"""The field of the study's ablations, in sparse views."""
FEW_FIELD = "ngp"
"""The field of the study's very sparse views."""


def role_of(prior: str) -> str:
    """Return what a prior is in the study: a row of it, or the method of one that it does not have.

    LiDAR, accumulated over sweeps, is what the study's true depth is made of.
    """
    if prior in (NONE, TRUTH.name):
        return prior
    method = cache.load(Path(prior)).method
    return numbers.TRUTH if method == "lidar" else method


@dataclass(frozen=True)
class Plan:
    """The runs of table 3, of few views, of the ablations and of the density curve."""

    priors: tuple[str, ...]
    """Folders of priors, truth and none, in the order of the table."""
    fields: tuple[str, ...] = tuple(numbers.FIELDS)
    seeds: tuple[int, ...] = (0, 1, 2)
    """Of table 3; all else has the first."""
    has_truth: bool = True
    """Whether the drive has true depth, which the mask of the ablation needs."""
    few: tuple[str, ...] = FEW_VIEWS
    """Shares of the views that are few, and that the drive has."""
    roles: Mapping[str, str] = field(init=False)
    """Prior -> its role; of several with one role the first is its row's."""

    def __post_init__(self) -> None:
        own = dict.fromkeys(self.priors)
        if NONE not in own or len(own) < 2:
            raise UsageError("--preset paper: compares priors with colours alone: --priors none cache/")
        object.__setattr__(self, "roles", {prior: role_of(prior) for prior in own})

    def prior(self, role: str) -> str | None:
        """Return the prior of a row of the study; None where there is none."""
        return next((prior for prior, own in self.roles.items() if own == role), None)

    def runs(self) -> list[RunSpec]:
        """List the runs, each once: the sparse half of table 3 first, seed by seed, so that a part of it tells most."""
        ordered: list[RunSpec] = []
        for seed in self.seeds:
            for views in ("sparse", "dense"):
                grid = Study(tuple(self.roles), ("mse",), (views,), self.fields, seeds=(seed,))
                ordered += grid.runs()
            if seed == self.seeds[0]:
                ordered += [*self.ablations(), *self.densities(), *self.few_views()]
        return list(dict.fromkeys(ordered))

    def few_views(self) -> list[RunSpec]:
        """List the runs on 1/8 and 1/16 of the views."""
        if FEW_FIELD not in self.fields:
            return []
        chosen = [self.prior(role) for role in (numbers.NONE, numbers.MONO, numbers.STEREO)]
        specs = [self._spec(prior, field=FEW_FIELD, views=views) for views in self.few for prior in chosen if prior]
        return [spec for spec in specs if spec is not None]

    def ablations(self) -> list[RunSpec]:
        """List the runs of table 6 that are not of table 3."""
        mono, stereo = self.prior(numbers.MONO), self.prior(numbers.STEREO)
        changes: list[Change] = [
            *((mono, {"loss": loss}) for loss in ("l1", "kl", "urf")),
            *((mono, {"clip": clip}) for clip in (40.0, 80.0)),
            *([(mono, {"truth_mask": True})] if self.has_truth else []),
            (stereo, {"confidence": CONFIDENT}),
        ]
        return self._changed(changes)

    def densities(self) -> list[RunSpec]:
        """List the runs of the density curve, under both rules of averaging."""
        dense = [self.prior(role) for role in (numbers.MONO, numbers.COMPLETION, numbers.STEREO)]
        shares: list[float | None] = [*DENSITIES, None]
        changes: list[Change] = [
            (prior, {"density": share, "over_all": over_all})
            for prior in dense
            for share in shares
            for over_all in (False, True)
        ]
        return self._changed([*changes, (self.prior(numbers.TRUTH), {"over_all": True})])

    def _changed(self, changes: Sequence[Change]) -> list[RunSpec]:
        if ABLATED not in self.fields:
            return []
        made = [self._spec(prior, **change) for prior, change in changes if prior is not None]
        return [spec for spec in made if spec is not None]

    def _spec(self, prior: str, **choices: Any) -> RunSpec | None:
        usual = {"field": ABLATED, "views": "sparse", "loss": None if prior == NONE else "mse", "seed": self.seeds[0]}
        return RunSpec(prior=prior, **usual | choices)
