"""Gaussians as the .ply of 3D Gaussian splatting: read back by its public layout, and shown again without the sky."""

from pathlib import Path

import numpy as np
import pytest
import torch
from test_nerf_export import read_ply
from test_nerf_fit import config as volumetric
from test_nerf_fit import corridor
from test_splat_fit import config

from nerf import fields
from nerf.export import write_splats
from nerf.gaussians import ply
from nerf.gaussians.model import SplatModel
from nerf.gaussians.shell import spread_directions
from nerf.gaussians.types import Drawing, Gaussians, Viewpoint
from nerf.kernels import kernels_for
from nerf.placed import PlacedModel
from priors.errors import DataError

pytestmark = pytest.mark.splats


def trained(steps: int = 4) -> SplatModel:
    scene, settings = corridor("sparse"), config(steps)
    model = fields.family("splat").start(scene, settings, "cpu")
    for step in range(steps):
        model.train(scene, settings, step, step / steps)
    assert isinstance(model, SplatModel)
    return model


def as_gaussians(points: np.ndarray) -> Gaussians:
    """Read as a viewer does: the original's `load_ply`."""
    columns = {name: torch.from_numpy(points[name].copy()) for name in points.dtype.names}

    def stacked(*names: str) -> torch.Tensor:
        return torch.stack([columns[name] for name in names], dim=-1)

    first = stacked("f_dc_0", "f_dc_1", "f_dc_2")[:, None]
    rest = stacked(*(f"f_rest_{n}" for n in range(45))).view(-1, 3, 15).transpose(1, 2)
    scales, turns = stacked("scale_0", "scale_1", "scale_2"), stacked("rot_0", "rot_1", "rot_2", "rot_3")
    return Gaussians(stacked("x", "y", "z"), scales, turns, columns["opacity"], torch.cat([first, rest], dim=1))


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    random = torch.Generator().manual_seed(0)
    shapes = ((7, 3), (7, 3), (7, 4), (7,), (7, 4, 3))
    gaussians = Gaussians(*(torch.randn(shape, generator=random) for shape in shapes))
    ply.write(tmp_path / "a.ply", gaussians)
    points = read_ply(tmp_path / "a.ply")
    assert list(points.dtype.names) == ply.NAMES and len(points.dtype.names) == 62
    back = as_gaussians(points)
    for name, tensor in gaussians.tensors().items():
        assert torch.equal(back.tensors()[name][:, :4] if name == "harmonics" else back.tensors()[name], tensor), name
    assert not back.harmonics[:, 4:].any()
    assert points["f_rest_1"].tolist() == gaussians.harmonics[:, 2, 0].tolist(), "all of red first"


def test_other_programs_see_the_sky_as_a_shell(tmp_path: Path) -> None:
    model, scene = trained(20), corridor("sparse")
    count = write_splats(tmp_path / "a.ply", model)
    gaussians = as_gaussians(read_ply(tmp_path / "a.ply"))
    assert count == len(gaussians) > len(model.gaussians)
    pose = scene.T_world_cam[scene.train[1]]
    drawn = kernels_for(torch.device("cpu")).splat.rasterise(
        gaussians, Viewpoint(scene.camera, pose), Drawing(degree=3)
    )
    own = model.render(pose, scene.camera)
    assert np.abs(drawn.rgb.clamp(0, 1).numpy() - own.rgb).mean() < 0.02
    assert float(drawn.opacity.min()) > 0.8


def test_far_from_zero_the_origin_is_told(tmp_path: Path) -> None:
    model = trained(1)
    write_splats(tmp_path / "far.ply", PlacedModel(model, (455000.0, 5428001.0, 110.0)))
    head = (tmp_path / "far.ply").read_bytes().split(b"end_header")[0].decode()
    assert "comment origin_m 455000 5428001 110" in head.splitlines()
    assert np.abs(read_ply(tmp_path / "far.ply")["x"]).max() < 4000


def test_what_cannot_be_written_is_told(tmp_path: Path) -> None:
    hash_field = fields.family("ngp").start(corridor("sparse"), volumetric(1), "cpu")
    with pytest.raises(DataError, match="a ngp field has no Gaussians: fit one with --field splat"):
        write_splats(tmp_path / "a.ply", hash_field)
    with pytest.raises(DataError, match=r"ends in \.ply"):
        write_splats(tmp_path / "a.splat", trained(1))
    assert not list(tmp_path.iterdir())


def test_the_shell_s_directions_are_even() -> None:
    units = spread_directions(500)
    assert torch.allclose(torch.linalg.vector_norm(units, dim=1), torch.ones(500), atol=1e-5)
    assert float(units.mean(0).abs().max()) < 1e-2
    nearest = (units @ units.T - 2 * torch.eye(500)).max(1).values.acos()
    assert float(nearest.max() / nearest.min()) < 2
