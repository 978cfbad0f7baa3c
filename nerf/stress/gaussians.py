"""Rows of the table: Gaussians, drawn and differentiated, with one of their parameters extreme; their loss and Adam."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from nerf.gaussians.types import (
    NAMES,
    Drawing,
    Gaussians,
    Rates,
    SplatGradients,
    SplatMoments,
    ViewGradients,
    Viewpoint,
)
from nerf.kernels import cpu_kernels, plain_kernels
from nerf.stress.inputs import NO_RAYS, NO_SAMPLES, NO_SIGMA
from nerf.stress.rays import tensor, wide
from nerf.twin import colour_loss as twin_loss
from nerf.twin import splat as twin
from nerf.types import STEEPEST
from priors.stress.inputs import CONSTANT, Given
from priors.stress.precision import Floats
from priors.stress.routine import FLOAT32_ONLY, NO_DEPTH, NO_MASK, Case, Gradient, Outputs, Routine, without
from priors.types import Camera

COUNT = 24
LONGEST_M = 1e3
TILE = 4
"""Pixels along a side of a tile: nerf/kernels/cpu/splat_project.py draws them side by side."""
SIZE = 9, 13
CAP_M = 20.0
DRAWING = Drawing(degree=1, least_alpha=1e-6, enough=0.0, cap_m=CAP_M, median=False)
"""No Gaussian and no pixel ends where a rounding decides."""
RESULTS = ("rgb", "depth_sum", "opacity")
PICTURE = 13, 15
RATES = Rates(means=0.01, log_scales=0.02, rotations=0.01, opacities=0.05, colours=0.01, view=0.001)
LEAST_MOMENT = 1e-9


class Made(NamedTuple):
    """What the formula shows of Gaussians at p pixels."""

    values: dict[str, Tensor]
    """Each (p, ...)."""
    scale: Tensor
    """(p,) largest part of an exponent that decides what is seen there; at least 1."""


def drawn(varied: str) -> Callable[[Given], Case]:
    """Return the case that draws Gaussians of which one parameter is extreme, and goes back to all parameters."""

    def case(given: Given) -> Case:
        at, seen_from = _scene(given, varied), _viewpoint(given)
        size = seen_from.camera.size
        pulls = {name: given.random.normal(size=(*size, 3) if name == "rgb" else size) for name in RESULTS}
        ours = Gaussians(*(tensor(at[name]) for name in NAMES))
        kernels = cpu_kernels().splat

        def found() -> Outputs:
            seen = kernels.rasterise(ours, seen_from, DRAWING)
            return {name: getattr(seen, name) for name in RESULTS}

        def gradients() -> Outputs:
            seen = kernels.rasterise(ours, seen_from, DRAWING)
            back = kernels.backward(seen, _pulled(pulls, tensor))
            return _whole(back, at)

        def loss(moved: Mapping[str, Floats]) -> Floats:
            made = _exact(moved, seen_from).values
            return np.concatenate([(made[name].numpy() * pulls[name]).ravel() for name in RESULTS])

        made = _exact(at, seen_from)
        scale = {"rgb": made.scale[..., None].numpy(), "opacity": made.scale.numpy()}
        scale["depth_sum"] = CAP_M * made.scale.numpy()
        gradient = Gradient(gradients, loss, at, _slopes(at, seen_from, pulls), _smooth(given, varied, at))
        return Case(found, lambda: made.values, scale, gradient, spreads=True)

    return case


def _pulled(pulls: Mapping[str, Floats], make: Callable[[Floats], Tensor]) -> ViewGradients:
    return ViewGradients(make(pulls["rgb"]), make(pulls["depth_sum"]), make(pulls["opacity"]))


def _viewpoint(given: Given) -> Viewpoint:
    """Return a camera that looks along z, a little turned."""
    height, width = given.size(*SIZE)
    K = np.array([[0.8 * width, 0, 0.45 * width], [0, 0.9 * width, 0.52 * height], [0, 0, 1.0]])
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", [0.1, 0.2, -0.1]).as_matrix()
    T[:3, 3] = 0.3, -0.1, 0.4
    return Viewpoint(Camera(K, (height, width)), T)


def _scene(given: Given, varied: str) -> dict[str, Floats]:
    """Return Gaussians ahead of the camera; the input's numbers are those of one parameter."""
    random, precision = given.random, given.precision
    middle = np.array([0.0, 0.0, 6.0])
    made = {
        "means_m": random.normal(size=(COUNT, 3)) * [2.0, 1.0, 2.0] + middle,
        "log_scales": np.log(given.plain(0.1, 0.6, (COUNT, 3))),
        "rotations": random.normal(size=(COUNT, 4)),
        "opacities": random.normal(size=COUNT),
        "harmonics": 0.4 * random.normal(size=(COUNT, 4, 3)),
    }
    values = given.values(0.1, 3.0, made[varied].shape, signed=varied != "log_scales")
    with np.errstate(divide="ignore", invalid="ignore"):
        made[varied] = np.log(values) if varied == "log_scales" else values + (middle if varied == "means_m" else 0)
    return {name: precision.rounded(value) for name, value in made.items()}


def _exact(at: Mapping[str, Floats], seen_from: Viewpoint) -> Made:
    """Draw in float64 by the twin; a colour that is no number spoils the tiles in which a pixel sees it."""
    size = seen_from.camera.size
    projected = twin.project(Gaussians(*(wide(at[name]) for name in NAMES)), seen_from, DRAWING)
    projected = projected.rows(torch.nonzero(twin.in_view(projected, size))[:, 0])
    projected = projected.rows(torch.sort(projected.z_m, stable=True).indices)
    y, x = torch.meshgrid(*(torch.arange(side, dtype=torch.float64) for side in size), indexing="ij")
    pixels = torch.stack([x.flatten(), y.flatten()], 1)
    blended = twin.blend(projected, pixels, DRAWING)
    weights = blended.weights
    tile = (y.flatten() // TILE * size[1] + x.flatten() // TILE).long()
    seen = torch.zeros(int(tile.max()) + 1, weights.shape[1]).index_add_(0, tile, (weights > 0).float())[tile] > 0
    parts = torch.where(seen[..., None], weights[..., None] * projected.rgb, 0.0)
    values = {
        "rgb": parts.sum(1).reshape(*size, 3),
        "depth_sum": (weights @ projected.z_m.clamp(max=CAP_M)).reshape(size),
        "opacity": weights.sum(1).reshape(size),
    }
    bright = (
        torch.where(torch.isfinite(parts), parts, 0.0).abs().amax((1, 2)) if len(projected.z_m) else pixels[:, 0] * 0
    )
    return Made(values, torch.maximum(_exponents(projected, pixels, weights), bright).reshape(size))


def _exponents(projected: twin.Projected, pixels: Tensor, weights: Tensor) -> Tensor:
    """Return the largest part of the exponents (p,) of what is seen: a needle's parts cancel."""
    dx, dy = (pixels[:, None] - projected.mean_px).unbind(2)
    a, b, c = projected.conic.unbind(1)
    parts = torch.stack([a * dx * dx, c * dy * dy, 2 * (b * dx * dy).abs(), torch.ones_like(dx)]).amax(0)
    return torch.where(weights > 0, parts, 1.0).amax(1) if len(projected.z_m) else torch.ones(len(pixels))


def _slopes(at: Mapping[str, Floats], seen_from: Viewpoint, pulls: Mapping[str, Floats]) -> dict[str, float]:
    """Return the natural scale of the gradient by turns: that by sizes, of whose parts it is the difference.

    A ball's is 0, and what is left of such a difference is rounding.
    """
    splat = plain_kernels().splat
    seen = splat.rasterise(Gaussians(*(wide(at[name]) for name in NAMES)), seen_from, DRAWING)
    back = splat.backward(seen, _pulled(pulls, wide)).of
    both = torch.cat([back.log_scales.flatten(), back.rotations.flatten()]).abs()
    largest = float(torch.where(torch.isfinite(both), both, 0.0).amax()) if len(both) else 0.0
    return {"rotations": largest} if largest > 0 else {}


def _smooth(given: Given, varied: str, at: Mapping[str, Floats]) -> dict[str, Any]:
    """Say where no derivative is compared.

    Of Gaussians at one place one that moves is suddenly before the others. One that is longer than LONGEST_M is drawn
    right, but its derivatives are differences of parts that are as many times larger as it is longer than a pixel.
    """
    if given.input is CONSTANT and varied == "means_m":
        return {"means_m": np.zeros((COUNT, 3), bool)}
    short = (at["log_scales"] <= np.log(LONGEST_M)).all(axis=1, keepdims=True)
    return {name: np.broadcast_to(short, at[name].shape) for name in ("means_m", "log_scales", "rotations")}


def _whole(back: SplatGradients, at: Mapping[str, Floats]) -> Outputs:
    """Return gradients of all Gaussians: those out of view have none."""
    found = {name: torch.zeros(at[name].shape) for name in NAMES}
    for name, value in found.items():
        value[back.index] = getattr(back.of, name)
    return found


def picture_loss(given: Given) -> Case:
    """Compare a picture with the true one by L1 and SSIM, and differentiate by it."""
    size = given.size(*PICTURE)
    rgb, truth = given.values(0.02, 1, (*size, 3)), given.plain(0.05, 1, (*size, 3))
    share = 0.2 if min(size) >= twin_loss.WINDOW else 0.0
    ours = tensor(rgb), tensor(truth)
    loss_of = cpu_kernels().splat.colour_loss

    def exact(values: Floats) -> tuple[Tensor, Tensor]:
        return twin_loss.parts(wide(values), wide(truth), share)

    def found() -> Outputs:
        made = loss_of(*ours, share)
        return {"absolute": made.absolute, "dissimilarity": made.dissimilarity}

    def loss(moved: Mapping[str, Floats]) -> Floats:
        absolute, unlike = exact(moved["rgb"])
        return np.array([(1 - share) * float(absolute), share * float(unlike)])

    def wanted() -> Outputs:
        absolute, unlike = exact(rgb)
        return {"absolute": float(absolute), "dissimilarity": float(unlike)}

    gradient = Gradient(lambda: {"rgb": loss_of(*ours, share).d_rgb}, loss, {"rgb": rgb})
    return Case(found, wanted, {"dissimilarity": 1.0}, gradient, spreads=True)


def adam(given: Given) -> Case:
    """Do a step of Adam for the Gaussians in view, by extreme gradients."""
    shapes = {"means_m": (3,), "log_scales": (3,), "rotations": (4,), "opacities": (), "harmonics": (4, 3)}
    plain = [given.plain(0.1, 1, (COUNT, *shape), signed=True) for shape in shapes.values()]
    index = torch.arange(0, COUNT, 2)
    slopes = [given.values(1e-6, 1, (len(index), *shape), signed=True) for shape in shapes.values()]
    means = [1e-3 * values for values in plain]
    squares = [np.square(values) * 1e-6 + LEAST_MOMENT for values in plain]
    unit_m = given.plain(0.01, 0.1, (COUNT,))

    def moved(make: Any, kernels: Any) -> Outputs:
        parts = (Gaussians(*(make(values).clone() for values in some)) for some in (plain, means, squares))
        gaussians, mean, square = parts
        of = Gaussians(*(make(values) for values in slopes))
        gradients = SplatGradients(index, of, torch.zeros(len(index)), torch.zeros(6))
        kernels.adam(gaussians, gradients, SplatMoments(mean, square, make(unit_m)), RATES, 7)
        return {
            f"{name}{what}": value
            for what, some in (("", gaussians), (" mean", mean), (" square", square))
            for name, value in some.tensors().items()
        }

    wanted = moved(wide, plain_kernels().splat)
    scale: dict[str, Any] = {}
    for name, before, slope, mean in zip(NAMES, plain, slopes, means, strict=True):
        held = np.zeros(before.shape)
        held[index.numpy()] = np.minimum(np.abs(np.where(np.isnan(slope), 0, slope)), STEEPEST)
        scale[name], scale[f"{name} mean"] = np.abs(before) + 1, np.maximum(np.abs(mean), held)
    return Case(lambda: moved(tensor, cpu_kernels().splat), lambda: wanted, scale, spreads=True)


OWN_ORIGIN = without("poses 5e5 m", why="the scene's origin is taken off before, in float64")
NO_SQUARE = without("1e30", why="SSIM squares colours: the loss is not finite, and the fit says so and stops")
PLAIN = {**OWN_ORIGIN, **NO_MASK, **NO_RAYS, **NO_SAMPLES, **NO_SIGMA}
NO_METRES = {**PLAIN, **NO_DEPTH}
WHERE = "nerf/kernels"
ROUTINES = (
    Routine("Gaussians' places", WHERE, drawn("means_m"), PLAIN, FLOAT32_ONLY),
    Routine("Gaussians' sizes", WHERE, drawn("log_scales"), PLAIN, FLOAT32_ONLY),
    Routine("Gaussians' turns", WHERE, drawn("rotations"), NO_METRES, FLOAT32_ONLY),
    Routine("Gaussians' opacities", WHERE, drawn("opacities"), NO_METRES, FLOAT32_ONLY),
    Routine("Gaussians' colours", WHERE, drawn("harmonics"), NO_METRES, FLOAT32_ONLY),
    Routine("pictures' L1 and SSIM", WHERE, picture_loss, {**NO_METRES, **NO_SQUARE}, FLOAT32_ONLY),
    Routine("Adam of Gaussians", WHERE, adam, NO_METRES, FLOAT32_ONLY),
)
