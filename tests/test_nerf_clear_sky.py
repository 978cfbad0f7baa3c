"""The sky of a fitted field is clear: clouds and meshes, which take the same pixels, have no points there."""

from dataclasses import replace

import numpy as np
import pytest
from test_nerf_fit import TRAINED, config, corridor

from nerf import fields
from nerf.export import CloudConfig, view_points
from nerf.sample import SamplerConfig
from nerf.scene import Scene

SHEET_M = 30.0
"""What a dense prior makes of the sky."""
ROOF_M = -3.2
"""No surface of the corridor is higher: y points down."""


def overcast(confidence: int) -> Scene:
    """The corridor with a prior that sees a sheet in the sky, as sure of it as it says, of 255."""
    scene = corridor(count=10)
    assert isinstance(scene.depth_m, np.ndarray)
    sky = scene.depth_m == 0
    depth_m = np.where(sky, SHEET_M, scene.depth_m).astype(np.float32)
    weight = np.where(sky, confidence, 255).astype(np.uint8)
    return replace(scene, depth_m=depth_m, weight=weight, sky=sky.astype(np.uint8))


def points(scene: Scene, family: str, switched_on: bool = True) -> tuple[int, int]:
    """Count what a short fit's views give to a cloud or a mesh: points of the corridor, points of the sky."""
    settings = config(60, family, **({} if switched_on else {"sky_opacity": 0.0}))
    sampler = SamplerConfig(render=96, carve_sky=switched_on)
    settings = replace(settings, model=replace(settings.model, sampler=sampler))
    model = fields.family(family).start(scene, settings, "cpu")
    for step in range(60):
        model.train(scene, settings, step, step / 60)
    pose = scene.T_world_cam[scene.test[0]]
    y_m = view_points(model.render(pose, scene.camera), scene.camera, pose, CloudConfig())[0]["y"]
    return int((y_m >= ROOF_M).sum()), int((y_m < ROOF_M).sum())


@pytest.mark.parametrize("family", ["ngp", *(pytest.param(x, marks=pytest.mark.slow) for x in TRAINED if x != "ngp")])
def test_a_guess_in_the_sky_gives_clouds_and_meshes_no_sheet(family: str) -> None:
    ground, sky = points(overcast(confidence=25), family)
    assert ground > 300
    assert sky < 0.01 * ground


@pytest.mark.slow
def test_a_sheet_that_is_believed_is_seen() -> None:
    """What the test above would see if the sky's pixels did nothing."""
    ground, sky = points(replace(overcast(confidence=255), sky=None), "ngp", switched_on=False)
    assert sky > 0.1 * ground
