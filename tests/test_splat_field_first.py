"""Without a prior a hash field shows the surfaces, and Gaussians start there; kills between change nothing."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from test_nerf_fit import corridor
from test_splat_fit import Killed, config, kill, psnr
from test_splat_start import off_m

from nerf import checkpoint, fields
from nerf.fit import fit
from nerf.gaussians import field_first
from nerf.gaussians.field_first import FieldFirst, shown_by
from nerf.gaussians.model import SplatModel
from nerf.gaussians.start import start_of
from nerf.scene import Scene
from nerf.types import RenderedView
from nerf.volumetric import VolumetricModel
from priors.types import Camera, Matrix

pytestmark = pytest.mark.splats


class Seen:
    """What a field shows that has learned the corridor: its depth, in the size of image that is asked for."""

    def __init__(self, scene: Scene) -> None:
        self.scene, self.asked = scene, 0

    def render(self, T_world_cam: Matrix, camera: Camera) -> RenderedView:
        assert self.scene.depth_m is not None
        self.asked += camera.size[0] * camera.size[1]
        at = int(np.argmin(np.linalg.norm(self.scene.T_world_cam[:, :3, 3] - T_world_cam[:3, 3], axis=1)))
        step = round(self.scene.camera.size[0] / camera.size[0])
        depth_m = np.asarray(self.scene.depth_m[at])[step // 2 :: step, step // 2 :: step]
        opacity = (depth_m > 0).astype(np.float32)
        return RenderedView(np.zeros((*depth_m.shape, 3), np.float32), depth_m, depth_m, opacity)


def test_gaussians_start_where_the_field_shows_surfaces(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = corridor("dense")
    field: Any = Seen(scene)
    shown = shown_by(field, replace(scene, depth_m=None))
    assert len(shown.train) == len(scene.train) <= field_first.FRAMES
    assert np.median(off_m(start_of(shown, 2, 10**6).means_m)) < 0.1
    monkeypatch.setattr(field_first, "FRAMES", 3)
    monkeypatch.setattr(field_first, "PIXELS", 3 * 64 * 24 // 4)
    small: Any = Seen(scene)
    few = shown_by(small, replace(scene, depth_m=None))
    assert (
        few.ids == [scene.ids[scene.train[at]] for at in (0, (len(scene.train) - 1) // 2 + 1, -1)] or len(few.ids) == 3
    )
    assert small.asked <= 3 * 64 * 24 // 4
    assert np.median(off_m(start_of(few, 2, 10**6).means_m)) < 0.4
    assert few.depth_m is not None and np.asarray(few.depth_m).shape == (3, *scene.camera.size)


def test_colours_alone_learn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gaussians go on from what the hash field learned, and show the frames better than it did."""
    monkeypatch.setattr(field_first, "SHARE", 0.5)
    scene, settings = corridor("sparse", prior=False), config(50, start_step=2)
    model: Any = fields.family("splat").start(scene, settings, "cpu")
    assert isinstance(model, FieldFirst)
    before = {}
    for step in range(50):
        if step in (0, 25):
            before[step] = psnr(model, scene, scene.train[0])
            assert isinstance(model.part, VolumetricModel)
        result = model.train(scene, settings, step, step / 50)
    assert isinstance(model.part, SplatModel) and set(result.terms) == {"rgb"}
    assert psnr(model, scene, scene.train[0]) > before[25] + 1 > before[0] + 1


def test_a_run_that_was_killed_in_either_part_ends_in_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(field_first, "SHARE", 0.3)
    scene, settings = corridor("8", prior=False), config(20, appearance=True)
    whole = fit(scene, settings, tmp_path / "whole")

    kinds = []
    for at in (3, 6, 7, 14):
        with pytest.raises(Killed):
            fit(scene, settings, tmp_path / "parts", kill(at))
        opened = checkpoint.open_model(tmp_path / "parts")
        kinds.append(type(opened))
        assert np.isfinite(opened.render(scene.T_world_cam[9], scene.camera).rgb).all()
    assert kinds == [VolumetricModel, VolumetricModel, SplatModel, SplatModel]
    parts = fit(scene, settings, tmp_path / "parts")
    assert whole.state().keys() == parts.state().keys()
    for name, tensor in whole.state().items():
        assert torch.equal(tensor, parts.state()[name]), name
    longer = fit(scene, replace(settings, steps=40), tmp_path / "parts")
    assert all(torch.isfinite(tensor).all() for tensor in longer.state().values()), "a larger budget goes on"
