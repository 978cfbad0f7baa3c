"""The gsplat package as a rasteriser: a stand-in of its documented function, drawn by our twin, takes its place.

https://docs.gsplat.studio/main/apis/rasterization.html
"""

import importlib.machinery
import sys
import types
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from test_nerf_fit import corridor
from test_splat_fit import config
from torch import Tensor

from nerf import fields
from nerf.gaussians.types import Drawing, Gaussians, ViewGradients, Viewpoint
from nerf.kernels import gsplat as theirs
from nerf.kernels.plain import splat as plain
from nerf.losses import LossConfig
from nerf.twin import splat as twin
from priors.errors import DataError, UsageError
from priors.types import Camera
from tests.splats import SMOOTH, cloud, viewpoint
from tests.test_splat_raster import near, same_gradients, wanted

pytestmark = pytest.mark.splats
FAR = replace(SMOOTH, cap_m=1e6, median=False, degree=2)


def rasterization(
    means: Tensor, quats: Tensor, scales: Tensor, opacities: Tensor, colors: Tensor, viewmats: Tensor, Ks: Tensor,
    width: int, height: int, near_plane: float = 0.01, far_plane: float = 1e10, radius_clip: float = 0.0,
    eps2d: float = 0.3, sh_degree: int | None = None, packed: bool = True, tile_size: int = 16,
    backgrounds: Tensor | None = None, render_mode: str = "RGB", sparse_grad: bool = False, absgrad: bool = False,
    rasterize_mode: str = "classic",
) -> tuple[Tensor, Tensor, dict[str, Any]]:  # fmt: skip
    """What the package's documentation says of it, one camera, by the twin: the camera moves by its autograd."""
    assert sh_degree is not None and (sh_degree + 1) ** 2 <= colors.shape[1] and render_mode == "RGB+D" and not packed
    K = Ks[0].detach().double().numpy() - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    R, t = viewmats[0, :3, :3], viewmats[0, :3, 3]
    drawing = replace(
        FAR, degree=sh_degree, near_m=near_plane, low_pass_px2=eps2d, compensate=rasterize_mode == "antialiased"
    )
    given = Gaussians(means, scales.log(), quats, torch.logit(opacities), colors)
    moved = twin.project(given, Viewpoint(Camera(K, (height, width)), _pose(R, t)), drawing, _motion(R, t))
    means_px = moved.mean_px[None]
    moved = moved._replace(mean_px=means_px[0])
    pixels = torch.stack(torch.meshgrid(torch.arange(width), torch.arange(height), indexing="xy"), -1).reshape(-1, 2)
    order = torch.sort(moved.z_m).indices
    drawn = twin.blend(moved.rows(order), pixels.to(means), drawing)
    rgb, depth, opacity = twin.sums(moved.rows(order), drawn, drawing)
    image = torch.cat([rgb, depth[:, None]], 1).reshape(1, height, width, 4)
    radii = (twin.in_view(moved, (height, width)).int() * 3)[None, :, None].expand(-1, -1, 2)
    return image, opacity.reshape(1, height, width, 1), {"radii": radii, "means2d": means_px}


def _pose(R: Tensor, t: Tensor) -> Any:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R.detach().double().numpy(), t.detach().double().numpy()
    return np.linalg.inv(T)


def _motion(R: Tensor, t: Tensor) -> Tensor:
    """Return zeros (6,) whose derivative reaches the matrix: the twist that a small change of it is."""
    turn = (R - R.detach()) @ R.detach().T
    w = 0.5 * torch.stack([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    v = t - t.detach() - torch.linalg.cross(w, t.detach(), dim=0)
    return torch.cat([v, w])


@pytest.fixture
def package(monkeypatch: pytest.MonkeyPatch) -> None:
    made = types.ModuleType("gsplat")
    made.__spec__ = importlib.machinery.ModuleSpec("gsplat", None)
    made.rasterization = rasterization  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "gsplat", made)


@pytest.mark.parametrize("compensate", [True, False])
@pytest.mark.parametrize("background", [None, torch.tensor([0.2, 0.5, 0.7])], ids=["black", "coloured"])
def test_its_picture_and_gradients_mean_what_ours_mean(
    package: None, compensate: bool, background: Tensor | None
) -> None:
    gaussians, seen_from, drawing = cloud(40, 16), viewpoint(), replace(FAR, compensate=compensate)
    made = theirs.rasterise(gaussians, seen_from, drawing, background)
    ours = plain.rasterise(gaussians, seen_from, drawing, background)
    torch.testing.assert_close(made.index, ours.index)
    for name in ("rgb", "depth_sum", "opacity"):
        near(getattr(made, name), getattr(ours, name), 2e-5, name)
    given = wanted((23, 38))
    for asked in (given, replace(given, depth_sum=None), ViewGradients(given.rgb)):
        same_gradients(theirs.backward(made, asked), plain.backward(ours, asked), 2e-4)


def test_single_gaussians_of_rays_are_refused(package: None) -> None:
    made = theirs.rasterise(cloud(5), viewpoint(), Drawing())
    parts = plain.contributions(plain.rasterise(cloud(5), viewpoint(), Drawing()), torch.tensor([3]))
    with pytest.raises(DataError, match="mse or l1"):
        theirs.backward(made, replace(wanted((23, 38)), contributions=parts))


def test_without_the_package_one_line_says_so() -> None:
    if theirs.is_there():
        pytest.skip("gsplat is installed")
    with pytest.raises(DataError, match="pip install gsplat"):
        theirs.rasterise(cloud(5), viewpoint(), Drawing())


def test_a_fit_learns_from_what_it_draws(package: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a CPU, where the stand-in draws: a step moves the Gaussians as ours does."""
    monkeypatch.setattr(theirs, "expect_usable", lambda device: None)
    scene = corridor("4")
    moved = []
    for rasteriser in ("ours", "gsplat"):
        settings = config(1, start_step=24, rasteriser=rasteriser)
        model = fields.family("splat").start(scene, settings, "cpu")
        before = model.parameters()["gaussians.opacities"].clone()
        model.train(scene, settings, 0, 0.0)
        moved.append(model.parameters()["gaussians.opacities"] - before)
    assert moved[0].abs().max() > 1e-3
    assert ((moved[0] - moved[1]).abs() < 0.1 * moved[0].abs().max()).float().mean() > 0.9


def test_a_fit_by_it_is_refused_without_the_package_or_a_gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    scene, settings = corridor("4"), config(1, rasteriser="gsplat")
    for there, told in (
        (False, "--rasteriser gsplat: gsplat is not installed"),
        (True, "the device is cpu: leave it out"),
    ):
        monkeypatch.setattr(theirs, "is_there", lambda there=there: there)
        with pytest.raises(DataError, match=told):
            fields.family("splat").start(scene, settings, "cpu")


def test_what_it_cannot_do_is_refused() -> None:
    with pytest.raises(UsageError, match=r"--loss kl.*mse, l1 or none"):
        config(1, LossConfig("kl"), rasteriser="gsplat")
    with pytest.raises(UsageError, match=r"--normal-weight 0\.1.*0 with --rasteriser gsplat"):
        config(1, normal_weight=0.1, rasteriser="gsplat")
