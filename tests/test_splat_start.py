"""A field of Gaussians starts on the surfaces that the prior shows, each taken once."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from test_nerf_fit import corridor

from nerf.gaussians.backdrop import Backdrop
from nerf.gaussians.cover import Cover, looked_through
from nerf.gaussians.growth import matrices
from nerf.gaussians.look import look_at
from nerf.gaussians.seeds import disc_axes
from nerf.gaussians.start import ROOM, start_of, usual_step
from nerf.scene import Scene
from priors.geometry import invert

pytestmark = pytest.mark.splats


def off_m(means_m: np.ndarray) -> np.ndarray:
    """Distance of places (n, 3) from the corridor's nearest surface, metres."""
    x, y, z = means_m.T
    return np.min([np.abs(np.abs(x) - 4), np.abs(y - 1.5), np.abs(z - 40)], axis=0)


def thinned(scene: Scene, share: float) -> Scene:
    """The prior as a LiDAR would have it: a few pixels of each frame."""
    assert scene.depth_m is not None
    kept = np.random.default_rng(0).random(scene.depth_m.shape) < share
    return replace(scene, depth_m=np.where(kept, scene.depth_m, 0).astype(np.float32))


def with_sky(scene: Scene) -> Scene:
    """The scene and its true sky, which has one colour: the mask knows skies of photographs."""
    sky = (np.asarray(scene.images) == np.rint(255 * np.array([0.6, 0.8, 1.0])).astype(np.uint8)).all(-1)
    return replace(scene, sky=sky.astype(np.uint8))


def test_discs_lie_on_the_surfaces_and_along_them() -> None:
    scene = with_sky(corridor("sparse"))
    seeds = start_of(scene, 2, 10**6)
    assert np.quantile(off_m(seeds.means_m), 0.95) < 0.1
    assert (seeds.means_m[:, 1] > -3.3).all(), "none in the sky"
    normal = matrices(torch.from_numpy(seeds.rotations)).numpy()[:, :, 2]
    floor = (np.abs(seeds.means_m[:, 1] - 1.5) < 0.01) & (np.abs(seeds.means_m[:, 0]) < 3)
    walls = (np.abs(np.abs(seeds.means_m[:, 0]) - 4) < 0.01) & (seeds.means_m[:, 1] < 1)
    assert floor.sum() > 50 and walls.sum() > 50
    assert np.median(-normal[floor, 1]) > 0.99, "up"
    assert np.median(-normal[walls, 0] * np.sign(seeds.means_m[walls, 0])) > 0.99, "inwards"


def test_every_surface_is_taken_once() -> None:
    scene = corridor("dense")
    once = start_of(replace(scene, train=[5]), 2, 10**6)
    twice = start_of(replace(scene, train=[5, 5, 5]), 2, 10**6)
    assert len(twice) == len(once)
    assert len(start_of(scene, 2, 10**6)) < 6 * len(once), "18 frames that see the same walls"


@pytest.mark.parametrize("step", [1, 3])
def test_cells_are_covered_as_the_slow_version_says(step: int) -> None:
    look, random = look_at(corridor("sparse"), 4), np.random.default_rng(0)
    means_m = (random.normal(size=(400, 3)) * (4, 2, 10) + (0, 0, 10)).astype(np.float32)
    cover = Cover()
    cover.add(means_m[:150])
    cover.add(means_m[150:])
    filled, covered = (np.zeros_like(look.depth_m[step // 2 :: step, step // 2 :: step], np.bool_) for _ in range(2))
    for place in means_m.astype(np.float64):
        x, y, z = invert(look.T_world_cam)[:3] @ [*place, 1]
        if z > 0:
            row, column = (40 * y / z + 11.5 + 0.5) / step, (40 * x / z + 31.5 + 0.5) / step
            if 0 <= row < filled.shape[0] and 0 <= column < filled.shape[1]:
                own = look.depth_m[step // 2 :: step, step // 2 :: step][int(row), int(column)]
                filled[int(row), int(column)] = True
                covered[int(row), int(column)] |= abs(z - own) < 0.08 * own
    found = cover.cells(look, step)
    assert np.array_equal(found[0], filled) and np.array_equal(found[1], covered)
    assert 5 < covered.sum() < filled.sum()


@pytest.mark.parametrize("share", [1.0, 0.05])
def test_all_that_is_no_sky_is_covered(share: float) -> None:
    scene = thinned(corridor("sparse"), share)
    cover = Cover()
    cover.add(start_of(scene, 2, 10**6).means_m)
    for position in scene.train:
        look = look_at(scene, position)
        filled, _ = cover.cells(look, 6)
        land = ~look.sky[3::6, 3::6]
        assert filled[land].mean() > 0.95


def test_a_prior_with_few_values_starts_near_the_surfaces_too() -> None:
    seeds = start_of(thinned(corridor("sparse"), 0.1), 2, 10**6)
    assert np.median(off_m(seeds.means_m)) < 0.1


def test_what_other_frames_look_through_is_left_out() -> None:
    scene = corridor("dense")
    assert scene.depth_m is not None
    wrong = scene.depth_m.copy()
    wrong[8, 8:16, 20:40] = 3.0  # a board in the air that no other frame has
    others = [look_at(scene, at) for at in (6, 7, 10, 11)]
    board = np.array([[0.0, 0.2, 6.0]], np.float32)
    assert looked_through(board, others).all()
    assert not looked_through(np.array([[4.0, 0.0, 12.0]], np.float32), others).any(), "the wall"
    seeds = start_of(replace(scene, depth_m=wrong), 2, 10**6)
    in_the_air = (
        (np.abs(seeds.means_m[:, 0]) < 1.5) & (seeds.means_m[:, 1] < 1) & (np.abs(seeds.means_m[:, 2] - 7) < 0.5)
    )
    assert not in_the_air.any()


def test_a_budget_makes_the_start_coarser() -> None:
    scene = corridor("sparse")
    whole = start_of(scene, 1, 10**6)
    assert 0 < len(start_of(scene, 1, len(whole) // 3)) <= len(whole) // 3
    usual = len(start_of(scene, 2, 10**6))
    assert len(start_of(scene, 0, int(1.1 * usual / ROOM))) == usual, "there is room for growth"
    assert 0 < len(start_of(scene, 0, usual)) <= ROOM * usual
    assert usual_step((120, 397)) == 2 < usual_step((375, 1242)) <= 4


def test_values_that_are_no_depth_are_ignored() -> None:
    scene = corridor("sparse")
    assert scene.depth_m is not None
    depth_m = scene.depth_m.copy()
    depth_m[:, ::3], depth_m[:, 1::3, ::2], depth_m[:, 2::3, :4] = np.nan, np.inf, -5
    seeds = start_of(replace(scene, depth_m=depth_m), 2, 10**6)
    assert all(np.isfinite(part).all() for part in (seeds.means_m, seeds.log_scales, seeds.rotations, seeds.rgb))
    assert np.median(off_m(seeds.means_m)) < 0.1


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**31))
def test_a_disc_looks_round(seed: int) -> None:
    """Its axes are orthonormal; along the slope it is as much longer as its look shortens it, three times at most."""
    random = np.random.default_rng(seed)
    points, normals = random.normal(size=(2, 20, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    axes, stretch = disc_axes(points, normals)
    assert np.allclose(axes.transpose(0, 2, 1) @ axes, np.eye(3), atol=1e-4)
    assert np.allclose(axes[:, :, 2], normals)
    sight = points / np.linalg.norm(points, axis=1, keepdims=True)
    seen = np.linalg.norm(np.cross(sight, axes[:, :, 0]), axis=1) * stretch
    assert np.allclose(seen[stretch < 2.99], 1, atol=1e-3)
    assert (stretch >= 1 - 1e-6).all() and (stretch <= 3).all()


def test_the_sky_has_its_colours_before_the_first_step() -> None:
    scene = corridor("sparse")
    sky = (np.asarray(scene.images) == np.rint(255 * np.array([0.6, 0.8, 1.0])).astype(np.uint8)).all(-1)
    backdrop = Backdrop(torch.device("cpu"))
    backdrop.paint(replace(scene, sky=sky.astype(np.uint8)))
    up = torch.nn.functional.normalize(torch.tensor([[0.0, -0.25, 1.0], [0.3, -0.25, 1.0]]), dim=1)
    assert torch.allclose(backdrop.sky.forward(up), torch.tensor([0.6, 0.8, 0.98]), atol=0.02)
    grey = Backdrop(torch.device("cpu"))
    grey.paint(replace(scene, sky=np.zeros_like(sky, np.uint8)))
    assert torch.equal(grey.sky.texels, torch.zeros_like(grey.sky.texels))
