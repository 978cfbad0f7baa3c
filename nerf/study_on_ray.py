"""A study on a Ray cluster: every run of the grid is a task with its own cores or GPU."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Any

from eval import lpips
from nerf.config import FitConfig
from nerf.report import Report
from nerf.study import FitRunner, Grid, Outcome, RunSpec, config_of, made_before, outcome_of
from priors.drives import reopen
from priors.machine import threads
from priors.scale.ray_session import Share
from priors.scale.tasks import run_tasks


@dataclass(frozen=True)
class Cell:
    """One run of a study, for another process."""

    spec: RunSpec
    folder: Path
    config: dict[str, Any]
    """What its report must hold."""
    command: str
    """What makes it alone."""
    drive: dict[str, Any]
    """What reopens the drive."""
    fit: FitConfig
    frames: str | None
    device: str
    lpips: tuple[Path, ...]
    """Weights of the LPIPS network; none: no such figure."""


def make_cell(cell: Cell) -> Outcome:
    """Make one run in this process."""
    network = lpips.load(cell.lpips) if cell.lpips else None
    runner = FitRunner(
        reopen(cell.drive), cell.fit, cell.frames, cell.device, network, command=lambda spec, folder: cell.command
    )
    with threads.limited(threads.count()):
        return outcome_of(cell.spec, cell.folder, cell.config, runner)


def run_study_on_ray(
    study: Grid,
    cell_of: Callable[[RunSpec, dict[str, Any]], Cell],
    settings: Mapping[str, Any],
    engine: tuple[ModuleType, Share],
    on_run: Callable[[Outcome], None] = lambda _: None,
) -> list[Outcome]:
    """Make the runs that are not done on a cluster; as nerf.study.run_study otherwise.

    Args:
        study: the grid.
        cell_of: returns the cell of a run and its config; folders mean the same on all nodes.
        settings: everything else that decides a run's figures.
        engine: a connected Ray, and what each run gets of a node.
        on_run: called after each run, in the order in which they end.
    """
    cells = {spec: cell_of(spec, config_of(spec, settings)) for spec in study.runs()}
    outcomes: dict[RunSpec, Outcome] = {}

    def tell(outcome: Outcome) -> None:
        outcomes[outcome.spec] = outcome
        on_run(outcome)

    left = []
    for spec, cell in cells.items():
        report: Report | None = made_before(cell.folder, cell.config)
        if report is None:
            left.append(spec)
        else:
            tell(Outcome(spec, report, fresh=False))
    for done in run_tasks(engine[0], make_cell, [cells[spec] for spec in left], engine[1]) if left else ():
        spec = left[done.number]  # the cell's own has its prior's whole path
        tell(Outcome(spec, None, done.error) if done.made is None else replace(done.made, spec=spec))
    return [outcomes[spec] for spec in cells]
