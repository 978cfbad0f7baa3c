"""Rates: how far a step moves each kind of a Gaussian's parameters."""

from nerf.gaussians.types import Rates
from nerf.optimise import OptimiserConfig

TOP = Rates(means=0.06, log_scales=0.03, rotations=0.03, opacities=0.1, colours=0.07, view=0.0035)
"""Of the first steps; places move by shares of a cell of the start."""


def rates_at(config: OptimiserConfig, step: int, progress: float) -> Rates:
    """Return the rates of the step-th step (from 1), `progress` of the fit done: they fall as all others do."""
    share = config.share(step, progress)
    return Rates(*(share * top for top in TOP))
