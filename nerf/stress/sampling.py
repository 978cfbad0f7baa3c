"""Rows of the table: samples along rays, and samples of even mass under weights."""

import numpy as np
import torch

from nerf.kernels import kernels_for, plain_kernels
from nerf.sample import Sampler
from nerf.space import Space
from nerf.stress.inputs import CENTRAL, LONG, NO_RAYS, NO_SIGMA, PARALLEL, SOLID
from nerf.stress.rays import LONGEST, packed, tensor
from nerf.twin import sample as twin
from nerf.types import Histogram, Rays
from priors.stress.inputs import Given
from priors.stress.routine import FLOAT32_ONLY, NO_MASK, NO_POSES, Case, Outputs, Routine, without

CPU = torch.device("cpu")
SPACE = Space("ball", (0.0, 0.0, 0.0), (30.0, 12.0, 10.0), 0.5, 250.0)


def marching(given: Given) -> Case:
    """March rays through a space: where samples lie, how long they are, and the place of each in the grid."""
    size = given.size(12)
    origins_m = np.stack(list(given.values(0.05, 20, (3, *size), signed=True)), axis=1)
    ways = np.concatenate([given.plain(0.01, 1, (*size, 2), signed=True), np.ones((*size, 1))], axis=1)
    if given.input is CENTRAL:
        origins_m = -given.random.uniform(0.5, 9, (*size, 1)) * ways
    if given.input is PARALLEL:
        ways[:, :2] = 0
    count = LONGEST if given.input is LONG else 24
    rays = Rays(tensor(origins_m), tensor(ways))
    exact = Rays(rays.origins_m.double(), rays.directions.double())

    def made(own: Rays, sampler: Sampler) -> Outputs:
        samples = sampler.march(own, count)
        return {name: getattr(samples, name)[: samples.used] for name in ("t", "dt_m", "s0", "s1", "u", "ray")}

    slow = Sampler(SPACE, None, plain_kernels().sample)
    along = {"t": SPACE.far_m, "dt_m": SPACE.far_m * 2, "s0": 1.0, "s1": 1.0, "u": 1.0, "ray": 1.0}
    return Case(lambda: made(rays, Sampler(SPACE)), lambda: made(exact, slow), along)


def resampling(given: Given) -> Case:
    """Put intervals where weights are: of even mass, within the bins."""
    rays = packed(given, reach_m=1.0)
    weights = given.values(1e-4, 0.5, (rays.used,))
    targets = (np.arange(17)[None] + given.random.uniform(0.1, 0.9, (rays.rays, 1))) / 17.9
    histogram = Histogram(rays.samples, tensor(rays.padded(weights)), margin=0.002, anneal=0.7)
    asked = tensor(targets)

    def wanted() -> Outputs:
        return {"ends": torch.stack(twin.resample(histogram, asked))}

    def found() -> Outputs:
        return {"ends": kernels_for(CPU).sample.resample(histogram, asked)}

    return Case(found, wanted, {"ends": 1.0})


SOMEWHERE = without("inf", "NaN", why="a camera is somewhere: a pose that is not finite is refused")
SHARES = without("inf", "NaN", "65504", "1e30", "1e6 m", SOLID.name, why="a weight is a share of the light: 1 at most")
ALONG = {**NO_SIGMA, **NO_MASK, **NO_POSES, **SOMEWHERE}
ROUTINES = (
    Routine(
        "samples along rays", "nerf/sample.py", marching, {**NO_SIGMA, **NO_MASK, **NO_POSES, **SOMEWHERE}, FLOAT32_ONLY
    ),
    Routine("resampling", "nerf/kernels", resampling, {**SHARES, **NO_RAYS, **NO_POSES}, FLOAT32_ONLY),
)
