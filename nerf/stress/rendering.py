"""Rows of the table: transmittance and compositing, and what is learned through them."""

from collections.abc import Mapping

import numpy as np
import torch

from nerf.kernels import kernels_for
from nerf.stress.inputs import NO_RAYS
from nerf.stress.rays import Packed, packed, tensor, wide
from nerf.twin import render as twin
from nerf.types import Gradients, Rendered
from priors.stress.inputs import Given
from priors.stress.precision import Floats
from priors.stress.routine import FLOAT32_ONLY, NO_POSES, Case, Gradient, Outputs, Routine

CPU = torch.device("cpu")
RESULTS = ("rgb", "depth_m", "transmittance", "weights")


def densities(given: Given, rays: Packed) -> Floats:
    """Return the input's densities (used,), 1/m."""
    return given.values(1e-3, 5, (rays.used,))


def compositing(given: Given) -> Case:
    """Render samples before a sky, and differentiate everything that was rendered."""
    rays = packed(given)
    sigma, rgb, sky = densities(given, rays), given.plain(0.05, 1, (rays.used, 3)), given.plain(0.05, 1, (rays.rays, 3))
    at = {"sigma": sigma, "rgb": rgb, "sky": sky}
    pulls = [given.random.normal(size=shape) for shape in ((rays.rays, 3), (rays.rays,), (rays.rays,), (rays.used,))]
    kernels = kernels_for(CPU).render
    ours = tensor(rays.padded(sigma)), tensor(rays.padded(rgb)), tensor(sky)
    rendered: list[Rendered] = []

    def found() -> Outputs:
        rendered.append(kernels.forward(rays.samples, *ours))
        return _results(rendered[0], rays)

    def gradients() -> Outputs:
        by_rgb, by_depth, by_end = (tensor(pull) for pull in pulls[:3])
        by_weight, by_tau = tensor(rays.padded(pulls[3])), torch.zeros(len(rays.samples.ray))
        given_back = Gradients(by_rgb, by_depth, by_end, by_weight, by_tau)
        slopes = kernels.backward(rays.samples, *ours, rendered[0], given_back)
        return {"sigma": slopes[0][: rays.used], "rgb": slopes[1][: rays.used], "sky": slopes[2]}

    def loss(moved: Mapping[str, Floats]) -> Floats:
        made = _exact(rays, moved)
        return np.concatenate([(made[name] * pull).ravel() for name, pull in zip(RESULTS, pulls, strict=True)])

    far_m = float(rays.wide.t.max()) if rays.used else 1.0
    scale = {"rgb": 1.0, "transmittance": 1.0, "weights": 1.0, "depth_m": far_m}
    return Case(found, lambda: _exact(rays, at), scale, Gradient(gradients, loss, at), spreads=True)


def _results(rendered: Rendered, rays: Packed) -> dict[str, torch.Tensor]:
    made = {name: getattr(rendered, name) for name in RESULTS}
    return {**made, "weights": made["weights"][: rays.used]}


def _exact(rays: Packed, at: Mapping[str, Floats]) -> dict[str, Floats]:
    """Render in float64 by the twin."""
    inputs = wide(rays.padded(at["sigma"])), wide(rays.padded(at["rgb"])), wide(at["sky"])
    made = _results(twin.render(rays.wide, *inputs), rays)
    return {name: value.numpy() for name, value in made.items()}


def median_depth(given: Given) -> Case:
    """Find the depth that half of the light comes from beyond: a sample's own, or 0."""
    rays = packed(given)
    sigma = densities(given, rays)
    sigma = np.where(np.isfinite(sigma), sigma, 0)
    zero = torch.zeros(len(rays.samples.ray), 3), torch.zeros(rays.rays, 3)
    ours = tensor(rays.padded(sigma))

    def wanted() -> Outputs:
        made = twin.render(rays.wide, wide(rays.padded(sigma)), *(each.double() for each in zero))
        return {"median": made.median_m}

    return Case(lambda: {"median": kernels_for(CPU).render.forward(rays.samples, ours, *zero).median_m}, wanted)


ROUTINES = (
    Routine("transmittance and compositing", "nerf/kernels", compositing, {**NO_POSES, **NO_RAYS}, FLOAT32_ONLY),
    Routine("median depth", "nerf/kernels", median_depth, {**NO_POSES, **NO_RAYS}, FLOAT32_ONLY),
)
