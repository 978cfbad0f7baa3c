"""Rows of the table: every loss and its gradient."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Literal

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from nerf.kernels import kernels_for
from nerf.losses import SOFT, LossConfig, losses
from nerf.stress.inputs import NO_RAYS, SOLID
from nerf.stress.rays import Packed, packed, tensor, wide
from nerf.stress.rendering import CPU, densities
from nerf.twin import render as twin
from nerf.types import LEAST_OPACITY, Rays, Target
from priors.stress.inputs import Given
from priors.stress.precision import Floats
from priors.stress.routine import FLOAT32_ONLY, NO_POSES, Case, Gradient, Outputs, Routine, without

Kind = Literal["mse", "l1", "kl", "urf"]
DEEPEST = 1e5
"""Optical depth of a wall."""
FULL = LossConfig(depth_weight=0.7, distortion=0.3, opacity=0.2, sky_opacity=0.1, trim=0.0)


def whole_loss(kind: Kind) -> Callable[[Given], Case]:
    """Return the case of the whole loss of a batch, and its gradient by the densities and by the colours."""

    def case(given: Given) -> Case:
        rays = packed(given)
        at = {"sigma": densities(given, rays), "rgb": given.plain(0.05, 1, (rays.used, 3))}
        batch = _batch(given, rays)
        config = replace(FULL, loss=kind)
        ours = tensor(rays.padded(at["sigma"])), tensor(rays.padded(at["rgb"])), torch.full((rays.rays, 3), 0.5)
        kernels = kernels_for(CPU).render

        def found() -> Outputs:
            made = losses(config, rays.samples, batch, ours[0], kernels.forward(rays.samples, *ours))
            return {"total": made.total, **made.terms}

        def gradients() -> Outputs:
            rendered = kernels.forward(rays.samples, *ours)
            made = losses(config, rays.samples, batch, ours[0], rendered)
            d_sigma, d_rgb, _ = kernels.backward(rays.samples, *ours, rendered, made.gradients)
            return {"sigma": d_sigma[: rays.used], "rgb": d_rgb[: rays.used]}

        def loss(moved: Mapping[str, Floats]) -> Floats:
            return _weighted(config, _parts(kind, rays, batch, moved)).numpy()

        parts = _parts(kind, rays, batch, at)
        terms = {name: float(part.sum()) for name, part in parts.items()}
        wanted = {"total": float(_weighted(config, parts).sum()), **terms}
        scale = {name: max(1.0, abs(value)) if np.isfinite(value) else 1.0 for name, value in wanted.items()}
        smooth = {"sigma": _has_logarithm(rays, at["sigma"])} if kind == "kl" else {}
        gradient = Gradient(gradients, loss, at, smooth=smooth)
        return Case(found, lambda: wanted, scale, gradient, spreads=True)

    return case


def _has_logarithm(rays: Packed, sigma: Floats) -> npt.NDArray[np.bool_]:
    """Tell where KL's logarithm is not held, and no wall makes it so large that differences see nothing else."""
    tau = sigma * rays.wide.dt_m[: rays.used].numpy()
    deepest = np.zeros(rays.rays)
    np.maximum.at(deepest, rays.ray, np.where(np.isfinite(tau), tau, 0))
    return np.asarray((tau > 10 * LEAST_OPACITY) & (deepest[rays.ray] < DEEPEST))


def _batch(given: Given, rays: Packed) -> Rays:
    """Return a batch: some rays have a prior (more or less trusted), some go to the sky."""
    count = rays.rays
    far_m = float(rays.samples.t.max()) if rays.used else 10.0
    depth_m = given.random.uniform(0.1, 0.9, count) * far_m * (given.random.random(count) < 0.8)
    trust, sky = given.random.uniform(0.2, 1, count), (given.random.random(count) < 0.3) * (depth_m == 0)
    directions = np.stack([np.sqrt(rays.norms.double().numpy() ** 2 - 1), np.zeros(count), np.ones(count)], axis=1)
    rgb = given.random.uniform(0, 1, (count, 3))
    known = tensor(depth_m), tensor(trust)
    return Rays(
        tensor(np.zeros((count, 3))), tensor(directions), tensor(rgb), *known, sky=tensor(sky.astype(np.float64))
    )


def _parts(kind: Kind, rays: Packed, batch: Rays, at: Mapping[str, Floats]) -> dict[str, Tensor]:
    """Return what each ray adds to the losses as nerf/losses.py states them, in float64, by the twin."""
    assert batch.rgb is not None and batch.depth_m is not None and batch.weight is not None and batch.sky is not None
    sigma, rgb = wide(rays.padded(at["sigma"])), wide(rays.padded(at["rgb"]))
    made = twin.render(rays.wide, sigma, rgb, torch.full((rays.rays, 3), 0.5, dtype=torch.float64))
    config = replace(FULL, loss=kind)
    depth_m = batch.depth_m.double()
    deviation_m = (config.sigma_share * depth_m).clamp(min=config.sigma_floor_m)
    target = Target(batch.norms.double(), depth_m, deviation_m)
    off = torch.where(depth_m > 0, made.depth_m - depth_m, 0.0) / config.unit_m
    each = {
        "mse": lambda: off**2,
        "l1": lambda: off.abs(),
        "kl": lambda: twin.kl(rays.wide, sigma, target),
        "urf": lambda: off**2 + twin.sight(rays.wide, made.weights, target),
    }[kind]()
    weight = torch.where(depth_m > 0, batch.weight.double(), 0.0)
    has_samples = rays.samples.offsets[1:] > rays.samples.offsets[:-1]
    stops = torch.where(weight > 0, weight**config.opacity_power, 0.0) * has_samples
    return {
        "rgb": (made.rgb - batch.rgb.double()).square().mean(1) / rays.rays,
        "depth": weight * each / weight.sum().clamp(min=1e-12),
        "opacity": stops * made.transmittance / (stops > 0).sum().clamp(min=1),
        "sky": -batch.sky * torch.log(made.transmittance + SOFT) / (batch.sky > 0).sum().clamp(min=1),
        "distortion": spread_of(rays, made.weights) / rays.rays,
    }


def _weighted(config: LossConfig, parts: Mapping[str, Tensor]) -> Tensor:
    """Return what each ray adds to each term of the whole loss: (terms * r,)."""
    weights = {"rgb": 1.0, "depth": config.depth_weight, "sky": config.sky_opacity}
    return torch.cat([weights.get(name, getattr(config, name, 0.0)) * part for name, part in parts.items()])


def spread_of(rays: Packed, weights: Tensor) -> Tensor:
    """Return the distortion (r,) as 2 times the integral of F (W - F) over s, F the weight before s, W all of it.

    The double sum of nerf/twin/render.py takes 4096^2 numbers a ray; the integral is the same number.
    """
    total = []
    for first, last in zip(rays.samples.offsets[:-1].tolist(), rays.samples.offsets[1:].tolist(), strict=True):
        w, s0, s1 = weights[first:last], rays.wide.s0[first:last], rays.wide.s1[first:last]
        before, whole = torch.cumsum(w, 0) - w, w.sum()
        inside = (s1 - s0) * (before * (whole - before) + w * (whole - 2 * before) / 2 - w * w / 3)
        between = (s0[1:] - s1[:-1]) * (before[1:] * (whole - before[1:]))
        total.append(2 * (inside.sum() + between.sum()))
    return torch.stack(total)


def distortion(given: Given) -> Case:
    """Measure how far a ray's weights are spread, and by which weights it changes."""
    rays = packed(given, reach_m=1.0)
    at = {"weights": given.values(1e-4, 0.3, (rays.used,))}
    return _by_weights(given, rays, at, "distortion")


def sight(given: Given) -> Case:
    """Compare a ray's weights with where the prior has its surface (URF)."""
    rays = packed(given)
    return _by_weights(given, rays, {"weights": given.values(1e-4, 0.3, (rays.used,))}, "sight")


def _by_weights(given: Given, rays: Packed, at: dict[str, Floats], kind: Literal["distortion", "sight"]) -> Case:
    kernels, pull = kernels_for(CPU).render, given.random.uniform(0.1, 1, rays.rays)
    batch = _batch(given, rays)
    assert batch.depth_m is not None
    deviation_m = (0.05 * batch.depth_m).clamp(min=0.1)
    aims: tuple[Target, ...] = () if kind == "distortion" else (Target(batch.norms, batch.depth_m, deviation_m),)
    wide_aims = [Target(*(x.double() for x in aim)) for aim in aims]
    ours, slopes = tensor(rays.padded(at["weights"])), torch.zeros(len(rays.samples.ray))

    def exact(moved: Mapping[str, Floats]) -> Tensor:
        weights = wide(rays.padded(moved["weights"]))
        return spread_of(rays, weights) if kind == "distortion" else twin.sight(rays.wide, weights, *wide_aims)

    def found() -> Outputs:
        return {"loss": getattr(kernels, kind)(rays.samples, ours, *aims, tensor(pull), slopes)}

    gradient = Gradient(lambda: {"weights": slopes[: rays.used]}, lambda moved: (exact(moved) * wide(pull)).numpy(), at)
    values = exact(at)
    return Case(found, lambda: {"loss": values}, {}, gradient, spreads=True)


def interlevel(given: Given) -> Case:
    """Ask a proposal's weights to bound the field's."""
    rays, coarse = packed(given, reach_m=1.0), packed(given, reach_m=1.0)
    fine, at = given.values(1e-4, 0.4, (rays.used,)), {"coarse": given.plain(1e-4, 0.2, (coarse.used,))}
    pull, ours = given.random.uniform(0.1, 1, rays.rays), tensor(rays.padded(fine))
    slopes: list[Tensor] = []

    def exact(moved: Mapping[str, Floats]) -> Tensor:
        weights = wide(rays.padded(fine)), wide(coarse.padded(moved["coarse"]))
        return twin.interlevel(rays.wide, weights[0], coarse.wide, weights[1])

    def found() -> Outputs:
        given_weights = ours, coarse.samples, tensor(coarse.padded(at["coarse"]))
        loss, slope = kernels_for(CPU).render.interlevel(rays.samples, *given_weights, tensor(pull))
        slopes.append(slope)
        return {"loss": loss}

    gradient = Gradient(
        lambda: {"coarse": slopes[0][: coarse.used]}, lambda moved: (exact(moved) * wide(pull)).numpy(), at
    )
    return Case(found, lambda: {"loss": exact(at)}, {}, gradient, spreads=True)


ONLY = {**NO_POSES, **NO_RAYS}
SHARES = {**ONLY, **without("65504", "1e30", "1e6 m", SOLID.name, why="a weight is a share of the light: 1 at most")}
ROUTINES = (
    *(
        Routine(f"whole loss, {kind}", "nerf/losses.py", whole_loss(kind), ONLY, FLOAT32_ONLY)
        for kind in ("mse", "l1", "kl", "urf")
    ),
    Routine("line of sight (URF)", "nerf/kernels", sight, SHARES, FLOAT32_ONLY),
    Routine("distortion", "nerf/kernels", distortion, SHARES, FLOAT32_ONLY),
    Routine("interlevel", "nerf/kernels", interlevel, SHARES, FLOAT32_ONLY),
)
