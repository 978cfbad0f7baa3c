"""The public package gsplat (Ye et al., JMLR 2025) as a rasteriser of the same functions, beside ours.

Nothing here needs it until it is called. Its pictures differ from ours where it has no setting: it stops at most 0.99
of the light at once, finishes a pixel at 1e-4, holds slopes to another reach, does not cap depth, and finds no median
depth. It looks at no single Gaussians of a ray. Pixel centres are at halves there, at whole numbers here.
"""

from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from nerf.gaussians.types import SIZES, Drawing, Gaussians, Rasterised, SplatGradients, ViewGradients, Viewpoint
from priors.errors import DataError

MISSING = "gsplat is not installed: pip install gsplat, where a CUDA toolkit is; or draw without it"


class Kept(NamedTuple):
    """What the way back needs: autograd's graph."""

    leaves: Gaussians
    T_cam_world: Tensor
    """(1, 4, 4)"""
    means_px: Tensor
    """(1, n, 2)"""
    drawn: tuple[Tensor, Tensor, Tensor]
    """rgb, depth_sum and opacity, with their graph."""


def expect_usable(device: torch.device) -> None:
    """Raise DataError where the package is missing, or the device is no GPU."""
    if not is_there():
        raise DataError(f"--rasteriser gsplat: {MISSING}")
    if device.type != "cuda":
        raise DataError(f"--rasteriser gsplat: it draws on a GPU alone, and the device is {device.type}: leave it out")


def is_there() -> bool:
    """Say whether the package is installed."""
    return find_spec("gsplat") is not None


def rasterise(
    gaussians: Gaussians, viewpoint: Viewpoint, drawing: Drawing, background: Tensor | None = None
) -> Rasterised:
    """Draw Gaussians near to far; background: (3,) or (h, w, 3).

    Raises:
        DataError: the package is not installed.
    """
    if not is_there():
        raise DataError(MISSING)
    from gsplat import rasterization

    device, (height, width) = gaussians.means_m.device, viewpoint.camera.size
    used = min(SIZES[drawing.degree], gaussians.harmonics.shape[1])
    given = dict(gaussians.tensors(), harmonics=gaussians.harmonics[:, :used])
    leaves = Gaussians(**{name: x.detach().clone().requires_grad_() for name, x in given.items()})
    T_cam_world = _on(device, np.linalg.inv(viewpoint.T_world_cam)).requires_grad_()
    K = viewpoint.camera.K + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    with torch.enable_grad():
        image, alphas, told = rasterization(
            means=leaves.means_m, quats=leaves.rotations, scales=leaves.log_scales.exp(),
            opacities=torch.sigmoid(leaves.opacities), colors=leaves.harmonics, viewmats=T_cam_world, Ks=_on(device, K),
            width=width, height=height, near_plane=drawing.near_m, eps2d=drawing.low_pass_px2,
            sh_degree=SIZES.index(used), packed=False, render_mode="RGB+D",
            rasterize_mode="antialiased" if drawing.compensate else "classic",
        )  # fmt: skip
        rgb, depth_sum, opacity = image[0, ..., :3], image[0, ..., 3], alphas[0, ..., 0]
        if background is not None:
            rgb = rgb + (1 - opacity)[..., None] * background
    radii_px = told["radii"][0].reshape(len(gaussians), -1).amax(1)  # of one number, or of two in newer versions
    index = torch.nonzero(radii_px > 0)[:, 0]
    kept = Kept(leaves, T_cam_world, told["means2d"], (rgb, depth_sum, opacity))
    shown = [x.detach() for x in kept.drawn]
    nothing = torch.zeros_like(shown[2])
    return Rasterised(shown[0], shown[1], shown[2], nothing, index, radii_px[index].float(), kept)


def backward(rasterised: Rasterised, gradients: ViewGradients) -> SplatGradients:
    """Return a loss's derivatives by the Gaussians in view.

    Raises:
        DataError: derivatives by single Gaussians of a ray are given.
    """
    if gradients.contributions is not None:
        raise DataError("gsplat knows no single Gaussians of a ray: expected a depth loss of whole pixels, mse or l1")
    kept: Kept = rasterised.kept
    given = [gradients.rgb, gradients.depth_sum, gradients.opacity]
    outputs = [(x, d) for x, d in zip(kept.drawn, given, strict=True) if d is not None]
    inputs = [*kept.leaves.tensors().values(), kept.means_px, kept.T_cam_world]
    found: Any = torch.autograd.grad(
        [x for x, _ in outputs], inputs, [d for _, d in outputs], retain_graph=True, materialize_grads=True
    )
    of = Gaussians(*(d[rasterised.index] for d in found[:5]))
    screen = torch.linalg.vector_norm(found[5][0, rasterised.index], dim=1)
    return SplatGradients(rasterised.index, of, screen, _twist(kept.T_cam_world.detach()[0], found[6][0]))


def _twist(T: Tensor, d_T: Tensor) -> Tensor:
    """Return the derivatives (6,) by a small motion of the scene in the camera's frame, from those by T (4, 4)."""
    turn = torch.linalg.cross(T[:3], d_T[:3], dim=0).sum(1)  # of x + w cross x: x cross d_x, of each column
    return torch.cat([d_T[:3, 3], turn])


def _on(device: torch.device, matrix: Any) -> Tensor:
    """Return a matrix as a batch of one."""
    return torch.from_numpy(np.asarray(matrix, np.float32))[None].to(device)
