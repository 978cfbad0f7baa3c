"""Render whole views of a model, in pieces that fit into memory."""

import numpy as np
import torch

from nerf.model import Model
from nerf.pictures import Render, RenderedView
from nerf.scene import view_rays
from nerf.types import Rays
from priors.machine import threads
from priors.types import Camera, Matrix

PIECE = 8192
"""Rays that are rendered at once."""


def renderer(model: Model) -> Render:
    """Return the function that renders a model from a pose."""

    @threads.quiet()
    def render(T_world_cam: Matrix, camera: Camera) -> RenderedView:
        rays = view_rays(camera, T_world_cam).to(model.device)
        pieces = [model.look(_part(rays, first)) for first in range(0, len(rays), PIECE)]
        height, width = camera.size

        def whole(name: str) -> np.ndarray:
            return torch.cat([getattr(piece, name) for piece in pieces]).cpu().numpy().reshape(height, width, -1)

        opacity = 1 - whole("transmittance")[..., 0]
        return RenderedView(whole("rgb"), whole("depth_m")[..., 0], whole("median_m")[..., 0], opacity)

    return render


def _part(rays: Rays, first: int) -> Rays:
    piece = slice(first, first + PIECE)
    return Rays(rays.origins_m[piece], rays.directions[piece], pixel=rays.pixel)
