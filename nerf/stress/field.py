"""Rows of the table: the field itself, hash grid and networks, and Adam; harmonics and the sky's pictures."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nerf.harmonics import harmonics
from nerf.kernels import kernels_for
from nerf.stress.inputs import NO_RAYS, NO_SAMPLES, NO_SIGMA
from nerf.stress.rays import tensor, wide
from nerf.twin import adam as twin_adam
from nerf.twin import encode as twin_encode
from nerf.twin import field as twin_field
from nerf.twin import sky as twin_sky
from nerf.types import STEEPEST, GridConfig, Layers
from priors.stress.inputs import ONE_PIXEL, Given
from priors.stress.precision import Floats
from priors.stress.routine import FLOAT32_ONLY, NO_DEPTH, NO_MASK, NO_POSES, Case, Gradient, Outputs, Routine
from priors.stress.tolerances import PrecisionName

CPU = torch.device("cpu")
GRID = GridConfig(levels=3, log2_size=8, coarsest=4, finest=24, tables=2)
COUNT, WIDTH, LEVELS, RAYS = 64, 16, 4, 5
INITIAL = 0.02
BFLOAT_ONLY: dict[PrecisionName, str] = dict.fromkeys(("fp32", "fp16"), "a field keeps bfloat16 on CPUs")
SIZES = (8, 32)
THINNEST = -87.0
"""Logarithm of a density, of the initial one, below which it is nothing: nerf/kernels/cpu/lanes.py, exponential."""


def encoding(given: Given) -> Case:
    """Look places up in a hash grid whose features are extreme; its gradient goes back to the grid's rows."""
    weights = given.values(1e-3, 1, (GRID.tables, GRID.rows, 2), signed=True)
    u = given.random.uniform(0, 1, (COUNT, 3)).astype(np.float32).astype(np.float64)
    table = torch.from_numpy(given.random.integers(0, GRID.tables, COUNT, dtype=np.int32))
    footprint = given.random.uniform(1e-3, 0.1, COUNT).astype(np.float32).astype(np.float64)
    if given.input is ONE_PIXEL:
        u[:], footprint[:] = 0.5, 0
    pull = given.precision.rounded(given.random.normal(size=(GRID.levels, COUNT, 2)))
    kernels = kernels_for(CPU).field
    places = tensor(u), table, tensor(footprint)
    ours = given.precision.tensor(weights)

    def exact(rows: Floats) -> Tensor:
        return twin_encode.encode(wide(u), table, wide(footprint), wide(rows), GRID)

    def gradients() -> Outputs:
        slopes = torch.empty(weights.shape)
        kernels.spread(*places, given.precision.tensor(pull), GRID, slopes)
        return {"weights": slopes}

    def loss(moved: Mapping[str, Floats]) -> Floats:
        return (exact(moved["weights"]) * wide(pull)).numpy().ravel()

    sizes = exact(np.abs(np.where(np.isfinite(weights), weights, 0)))
    return Case(
        lambda: {"features": kernels.encode(*places, ours, GRID)},
        lambda: {"features": exact(weights)},
        {"features": sizes.numpy()},
        Gradient(gradients, loss, {"weights": weights}),
        spreads=True,
    )


def networks(given: Given) -> Case:
    """Turn features into density and colour, and go back through both networks.

    A hidden neuron's weights have one sign and the features are above 0: no gate opens or shuts by rounding.
    """
    features = given.values(0.05, 1, (LEVELS, COUNT, 2))
    layers, basis, ray = _layers(given), harmonics(_units(given, RAYS)).abs(), _rays_of(given)
    ours = given.precision.tensor(features), given.precision.tensor(basis.numpy()).float(), ray
    kernels, own = kernels_for(CPU).field, Layers(*(tensor(layer) for layer in layers))
    exact_basis = wide(given.precision.rounded(basis.numpy()))

    def exact(values: Floats, weights: Layers) -> tuple[Tensor, Tensor]:
        return twin_field.shade(wide(values), exact_basis, ray, weights, INITIAL)

    plain = Layers(*(wide(layer) for layer in layers))
    logit = twin_field.density(wide(features), plain, INITIAL)[1][:, 0]
    free = ((logit < twin_field.LOGIT_MAX) & torch.isfinite(logit)).double()
    pulls = wide(given.random.normal(size=COUNT)) * free, wide(given.random.normal(size=(COUNT, 3)))

    def gradients() -> Outputs:
        d_features, _ = kernels.shade_backward(*ours, own, INITIAL, pulls[0].float(), pulls[1].float())
        return {"features": d_features}

    def loss(moved: Mapping[str, Floats]) -> Floats:
        sigma, rgb = exact(moved["features"], plain)
        return torch.cat([sigma * pulls[0], (rgb * pulls[1]).sum(1)]).numpy()

    def wanted() -> Outputs:
        sigma, rgb = exact(features, plain)
        return {"log density": torch.log(sigma / INITIAL).clamp(min=THINNEST), "rgb": rgb}

    def found() -> Outputs:
        sigma, rgb = kernels.shade(*ours, own, INITIAL)
        return {"log density": torch.log(sigma / INITIAL).clamp(min=THINNEST), "rgb": rgb}

    size = np.where(np.isfinite(logit.numpy()), np.maximum(1, np.abs(logit.numpy())), 1)
    gradient = Gradient(gradients, loss, {"features": features})
    return Case(found, wanted, {"log density": size, "rgb": 1.0}, gradient, spreads=True)


def _layers(given: Given) -> list[Floats]:
    """Return the layers' weights: (out, in), a hidden neuron's all of one sign."""
    made = []
    for rows, columns in ((WIDTH, 2 * LEVELS), (16, WIDTH), (WIDTH, 32), (WIDTH, WIDTH), (3, WIDTH)):
        weights = given.random.uniform(0.2, 1, (rows, columns)) * (2 / columns)
        signs = given.random.choice([1, 1, 1, -1], rows) if rows == WIDTH else np.ones(rows)
        made.append(given.precision.rounded(weights * signs[:, None]))
    return made


def _units(given: Given, count: int) -> Tensor:
    return torch.nn.functional.normalize(tensor(given.random.normal(size=(count, 3))), dim=-1)


def _rays_of(given: Given) -> Tensor:
    return torch.from_numpy(given.random.integers(0, RAYS, COUNT, dtype=np.int32))


def adam(given: Given) -> Case:
    """Do a step of Adam from moments that a fit has."""
    size = given.size(300)
    gradient, weights = given.values(1e-6, 1, size, signed=True), given.plain(0.01, 1, size, signed=True)
    mean, square = given.plain(1e-6, 1, size, signed=True), given.plain(1e-9, 1, size)
    rate, step = 1e-2, 7
    start = {"weights": weights, "mean": mean, "square": square}

    def moved(make: Any, run: Any) -> Outputs:
        tensors = {name: make(values).clone() for name, values in start.items()}
        tensors["weights"].grad = make(gradient)
        run(*tensors.values())
        return {name: value.detach() for name, value in tensors.items()}

    def fast(weights: Tensor, mean: Tensor, square: Tensor) -> None:
        kernels_for(CPU).field.adam(weights, mean, square, None, rate, step)

    def slow(weights: Tensor, mean: Tensor, square: Tensor) -> None:
        twin_adam.adam(weights, mean, square, rate, step)

    held = np.minimum(np.abs(np.where(np.isnan(gradient), 0, gradient)), STEEPEST)
    far = np.abs(moved(wide, slow)["weights"].numpy() - weights)
    scale = {"mean": np.maximum(np.abs(mean), held), "weights": np.abs(weights) + np.where(np.isfinite(far), far, 0)}
    return Case(lambda: moved(tensor, fast), lambda: moved(wide, slow), scale, spreads=True)


def sky(given: Given) -> Case:
    """Look directions up in the sky's pictures, and paint what is learned of them."""
    texels = given.values(0.01, 3, (sum(size**2 for size in SIZES), 3), signed=True)
    directions = np.asarray(_units(given, 40).double())
    if given.input is ONE_PIXEL:
        directions = np.array([[0.0, 0.0, 1.0]])
    directions[:1] = [0.0, 0.0, -1.0]  # where the octahedron's fold meets
    ours, pull = tensor(directions), tensor(given.random.normal(size=(len(directions), 3)))
    kernels = kernels_for(CPU).render

    def exact(values: Floats) -> Tensor:
        return twin_sky.look(wide(values), wide(directions), SIZES)

    def gradients() -> Outputs:
        slopes = torch.empty(texels.shape)
        kernels.paint(pull, ours, SIZES, slopes)
        return {"texels": slopes}

    def loss(moved: Mapping[str, Floats]) -> Floats:
        return (exact(moved["texels"]) * pull.double()).numpy().ravel()

    around = np.abs(np.where(np.isfinite(texels), texels, 0))[twin_sky.corners(wide(directions), SIZES)[0].numpy()]
    gradient = Gradient(gradients, loss, {"texels": texels})
    return Case(
        lambda: {"sums": kernels.look(tensor(texels), ours, SIZES)},
        lambda: {"sums": exact(texels)},
        {"sums": around.max(axis=1)},
        gradient,
        spreads=True,
    )


PLAIN = {**NO_POSES, **NO_MASK, **NO_DEPTH, **NO_RAYS, **NO_SAMPLES, **NO_SIGMA}
ROUTINES = (
    Routine("hash grid encoding", "nerf/kernels", encoding, PLAIN, BFLOAT_ONLY),
    Routine("networks", "nerf/kernels", networks, PLAIN, BFLOAT_ONLY),
    Routine("Adam", "nerf/kernels", adam, PLAIN, FLOAT32_ONLY),
    Routine("sky's pictures", "nerf/kernels", sky, PLAIN, FLOAT32_ONLY),
)
