"""Pixels that the other frames contradict do not count: a box that moves through the corridor."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from test_nerf_fit import corridor
from test_splat_fit import trained

from nerf.gaussians.movers import counted, unexplained
from nerf.gaussians.shot import Shot, shot_of
from nerf.losses import LossConfig
from nerf.scene import Scene

pytestmark = pytest.mark.splats
BOX = np.array([250, 20, 200], np.uint8)


def at(number: int) -> tuple[slice, slice]:
    """Where the box stands in a frame."""
    left = 4 + (11 * number) % 44
    return slice(9, 17), slice(left, left + 10)


def crossed(scene: Scene) -> Scene:
    """The corridor with a box before the camera that stands elsewhere in every frame."""
    images, depth_m = np.array(scene.images), np.array(scene.depth_m)
    for number in range(len(scene.ids)):
        images[number][at(number)], depth_m[number][at(number)] = BOX, 2.5
    return replace(scene, images=images, depth_m=depth_m)


def shot_and_view(scene: Scene, clean: Scene, number: int) -> tuple[Shot, torch.Tensor, torch.Tensor]:
    """A frame, and what Gaussians show of it that know the corridor well."""
    shot = shot_of(scene, number, LossConfig(), torch.device("cpu"))
    noise = 0.01 * torch.randn(*shot.rgb.shape, generator=torch.Generator().manual_seed(0))
    shown = torch.from_numpy(clean.images[number] / np.float32(255)) + noise
    return shot, shown, torch.from_numpy(np.array(clean.depth_m)[number])


def test_a_box_that_moves_does_not_count_and_all_else_does() -> None:
    clean = corridor("dense")
    shot, shown, depth_m = shot_and_view(crossed(clean), clean, 7)
    counts = counted(shown, depth_m, shot).numpy()
    box = np.zeros(counts.shape, bool)
    box[at(7)] = True
    assert counts[box].mean() < 0.1 and counts[~box].mean() > 0.85
    assert counted(shown, depth_m, replace(shot, depth_m=None)).numpy()[box].mean() < 0.1, "colours alone tell, too"
    assert counted(shown, 0 * depth_m + 2, shot).numpy().all(), "what is shown is no farther: only its colour is off"


def test_where_nothing_moves_all_counts() -> None:
    clean = corridor("dense")
    assert counted(*shot_and_view(clean, clean, 7)[1:], shot_and_view(clean, clean, 7)[0]).numpy().all()


def test_what_is_a_pixel_off_is_explained() -> None:
    random = np.random.default_rng(0)
    truth = random.random((20, 30, 3)).astype(np.float32)
    assert unexplained(np.roll(truth, 1, axis=1), truth)[:, 4:-4].max() == 0
    assert unexplained(truth + np.float32(2), truth).min() > 1


def test_the_corridor_is_seen_behind_the_box() -> None:
    """Where a training frame has the box, a render shows more of what is behind it."""
    clean = corridor("dense")
    scene = crossed(clean)
    off = {}
    for robust in (True, False):
        model = trained(scene, 150, start_step=2, robust=robust)
        wrong = []
        for number in scene.train[::4]:
            view = model.render(scene.T_world_cam[number], scene.camera).rgb
            wrong.append(((view - clean.images[number] / 255) ** 2)[at(number)].mean())
        off[robust] = float(np.mean(wrong))
    assert off[True] < 0.8 * off[False], off
