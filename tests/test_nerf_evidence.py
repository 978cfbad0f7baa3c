"""The check of a prior: it finds another scale, gross errors and what does not belong, and leaves a right one be."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import map_coordinates
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from nerf.config import FitConfig
from nerf.evidence import check as checking
from nerf.evidence import scale as scaling
from nerf.evidence.check import check
from nerf.evidence.corrected import LEAST_TRUST, Corrected
from nerf.evidence.finding import Finding
from nerf.evidence.votes import RULES
from nerf.evidence.whole import trusted_whole
from nerf.kernels.cpu.surfaces import STEPS, surfaces
from nerf.kernels.cpu.votes import STRIDE, Voter, pool, vote
from nerf.kernels.cpu.warp_draw import NONE
from nerf.scene import Scene
from nerf.stack import Stack, StackWriter
from nerf.warp.draw import between
from priors.geometry import rays as pixel_rays
from priors.records import earlier, restore
from tests.reference import votes as slow
from tests.test_nerf_fit import CAMERA, SIZE, corridor


@pytest.fixture(autouse=True)
def few_patches(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scaling, "PATCHES", 150)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return spotted(corridor(count=12))


def spotted(plain: Scene) -> Scene:
    """The corridor, its surfaces covered with spots of 0.6 m."""
    spots = np.random.default_rng(1).uniform(0, 255, (32, 32, 32))
    images = np.array(plain.images)
    for position, pose in enumerate(plain.T_world_cam):
        place_m = pixel_rays(CAMERA) * maps(plain)[position][..., None] + pose[:3, 3]
        paint = map_coordinates(spots, np.moveaxis(place_m / 0.6, -1, 0), order=1, mode="grid-wrap")
        seen = maps(plain)[position] > 0
        images[position][seen] = np.rint(paint[seen])[:, None]
    return replace(plain, images=images)


def maps(scene: Scene) -> np.ndarray:
    assert scene.depth_m is not None
    return np.stack([scene.depth_m[position] for position in range(len(scene.ids))])


def with_maps(scene: Scene, depth_m: np.ndarray) -> Scene:
    return replace(scene, depth_m=depth_m.astype(np.float32))


def used(scene: Scene) -> np.ndarray:
    """The maps of the training frames that a fit would see."""
    assert scene.depth_m is not None
    return np.stack([scene.depth_m[position] for position in scene.train])


def test_a_right_prior_is_left_as_it_is(scene: Scene) -> None:
    checked = check(scene)
    assert checked.finding is not None
    assert (checked.finding.scale, checked.finding.spread, checked.finding.used) == (1.0, (1.0, 1.0), True)
    assert checked.finding.patches > 1000
    assert checked.finding.told("it")[:-1] == []  # but for the sky, which painted walls look like
    assert checked.finding.dropped == 0
    assert checked.scene is scene


@pytest.mark.parametrize("factor", [0.5, *(pytest.param(x, marks=pytest.mark.slow) for x in (0.1, 0.7, 2.0, 8.0))])
def test_another_scale_is_found_and_mended(scene: Scene, factor: float) -> None:
    checked = check(with_maps(scene, factor * maps(scene)))
    assert checked.finding is not None
    assert checked.finding.scale == pytest.approx(1 / factor, rel=0.04)
    assert checked.finding.used
    assert "scale" in checked.finding.told("it")[0]
    now, true = used(checked.scene), used(scene)
    off = np.abs(now / np.where(true > 0, true, 1) - 1)[now > 0]
    assert np.median(off) < 0.04


@pytest.mark.slow
def test_a_scale_that_drifts_is_followed() -> None:
    scene = spotted(corridor("sparse", count=30))
    drift = 1 + 0.2 * np.sin(np.arange(len(scene.ids)) / 3)
    checked = check(with_maps(scene, maps(scene) * drift[:, None, None]))
    assert checked.finding is not None
    now, true = used(checked.scene), used(scene)
    kept = now > 0
    left = np.array([np.median(n[k] / t[k]) for n, t, k in zip(now, true, kept, strict=True)])
    assert np.abs(left - 1).max() < 0.06
    assert np.abs(left - 1).mean() < 0.02
    assert "drifts: its depths are multiplied by 0.8" in checked.finding.told("it")[0]


@pytest.mark.parametrize(
    ("side", "factor"),
    [(1, 10.0), (5, 0.1), *(pytest.param(*x, marks=pytest.mark.slow) for x in ((5, 10.0), (1, 0.1)))],
)
def test_gross_errors_are_left_out(scene: Scene, side: int, factor: float) -> None:
    """30 % of the values wrong by 10x."""
    random, depth_m = np.random.default_rng(5), maps(scene)
    coarse = random.random((len(depth_m), -(-SIZE[0] // side), -(-SIZE[1] // side))) < 0.3
    wrong = np.repeat(np.repeat(coarse, side, axis=1), side, axis=2)[:, : SIZE[0], : SIZE[1]]
    checked = check(with_maps(scene, np.where(wrong, factor, 1) * depth_m))
    assert checked.finding is not None
    assert checked.finding.scale == 1
    assert checked.finding.used
    now, there = used(checked.scene) > 0, used(scene) > 0
    bad = wrong[scene.train] & there
    assert (now & bad).sum() < (0.4 if side == 5 and factor < 1 else 0.15) * bad.sum()
    assert (now & ~bad).sum() > 0.98 * (there & ~bad).sum()
    assert any("contradict" in line for line in checked.finding.told("it"))


@pytest.mark.parametrize("seed", [4, *(pytest.param(x, marks=pytest.mark.slow) for x in (3, 5))])
def test_a_prior_of_something_else_is_left_out(scene: Scene, seed: int) -> None:
    """Maps of another place: each frame has a wall where it pleases."""
    walls_m = np.random.default_rng(seed).uniform(2, 60, (len(scene.ids), 1, 1)) * np.ones(SIZE)
    other = with_maps(scene, walls_m)
    checked = check(other)
    assert checked.finding is not None
    assert not checked.finding.used
    assert checked.scene.depth_m is None
    assert "goes on by colours" in checked.finding.told("it")[0]
    needed = check(other, needed=True)
    assert needed.scene.depth_m is not None


def test_what_images_cannot_tell_is_used_as_it_is(scene: Scene) -> None:
    still = replace(scene, T_world_cam=np.tile(np.eye(4), (len(scene.ids), 1, 1)))
    blank = replace(scene, images=np.full_like(scene.images, 128))
    for poor in (still, blank, replace(scene, train=scene.train[:1])):
        checked = check(poor)
        assert checked.finding is not None
        assert replace(checked.finding, sky=0.0) == Finding()
        assert np.array_equal(used(checked.scene), used(poor))
        assert "could not be checked" in checked.finding.told("it")[0]


@pytest.mark.parametrize("grey", [0, 255])
def test_blank_images_do_not_train(scene: Scene, tmp_path: Path, grey: int) -> None:
    """A black image, or a white one; with a prior or without."""
    images = np.array(scene.images)
    images[[4, 9]] = grey  # one trains, one is held out
    for prior_m in [None, scene.depth_m][: 2 if grey == 0 else 1]:
        checked = check(replace(scene, images=images, depth_m=prior_m))
        assert checked.finding is not None
        assert checked.finding.blank == ("000004",)
        assert checked.scene.train == [position for position in scene.train if position != 4]
        assert "000004: blank" in checked.finding.told(None)[0]
    dark = replace(scene, images=np.full_like(images, grey), depth_m=None)
    assert check(dark).finding is None  # where all are, there is nothing else to learn


@pytest.mark.parametrize("tells", [True, False])
def test_the_lidar_is_a_second_witness(scene: Scene, tells: bool) -> None:
    """Where images cannot tell the scale, it does; where they can, it is told that the two do not agree."""
    seen = scene if tells else replace(scene, images=np.full_like(scene.images, 128))
    truth = maps(scene)

    def sweep(position: int) -> np.ndarray | None:
        assert position in scene.train
        return (
            None if position == 4 else np.where(np.indices(SIZE).sum(0) % 3, 0, (1.5 if tells else 1) * truth[position])
        )

    finding = check(with_maps(seen, (1 if tells else 0.5) * truth), sweeps=sweep).finding
    assert finding is not None
    assert finding.lidar == pytest.approx(1.5 if tells else 2)
    assert finding.scale == pytest.approx(1 if tells else 2)
    assert any(("LiDAR at 1.50" if tells else "its scale is the LiDAR's") in line for line in finding.told("it"))


@pytest.mark.slow
def test_held_out_frames_take_no_part(scene: Scene) -> None:
    blind = with_maps(scene, maps(scene))
    blind.depth_m[scene.test] = 7.0  # type: ignore[index]
    images = np.array(scene.images)
    images[scene.test] = 0
    assert check(replace(blind, images=images)).finding == check(scene).finding


def test_it_is_checked_once(scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = np.random.default_rng(5).random(maps(scene).shape) < 0.3
    with StackWriter(tmp_path / "depth.npy", maps(scene).shape, np.float32) as file:
        for each in np.where(wrong, 5, 0.5) * maps(scene):
            file.add(each)
    filed = replace(scene, depth_m=Stack(tmp_path / "depth.npy"))
    first = check(filed)
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".json", ".npy", ".npy"]
    assert np.array_equal(used(first.scene), used(check(with_maps(scene, maps(filed))).scene))
    monkeypatch.setattr(checking, "_Check", None)
    again = check(filed)
    assert again.finding == first.finding
    assert isinstance(again.scene.depth_m, Corrected)
    assert np.array_equal(used(again.scene), used(first.scene))
    pixels = np.array([0, 4]), np.array([20, 3]), np.array([5, 60])
    assert np.array_equal(
        again.scene.depth_m[pixels], np.array([again.scene.depth_m[0][20, 5], again.scene.depth_m[4][3, 60]])
    )


def test_earlier_runs_took_priors_as_they_are() -> None:
    begun = restore(FitConfig, {"losses": {}})
    assert (begun.align, begun.losses.trim) == ("none", 0)
    assert earlier(FitConfig(), begun) == begun
    assert earlier(FitConfig(align="learn"), begun).align == "learn"


@pytest.mark.parametrize("seed", [0, 1])
def test_surfaces_are_what_neighbours_connect(seed: int) -> None:
    """Against scipy's connected components of the same graph."""
    random = np.random.default_rng(seed)
    inverse = np.where(random.random(SIZE) < 0.8, random.choice([0.1, 0.105, 0.2], SIZE), NONE).astype(np.float32)
    number, edges = np.arange(inverse.size).reshape(SIZE), []
    for row in range(SIZE[0]):
        for column in range(SIZE[1]):
            for down, right in STEPS:
                y, x = row + down, column + right
                if y < SIZE[0] and 0 <= x < SIZE[1] and min(inverse[row, column], inverse[y, x]) > 0:
                    ratio = inverse[row, column] / inverse[y, x]
                    if 1 / 1.1 < ratio < 1.1:
                        edges.append((number[row, column], number[y, x]))
    graph = coo_matrix((np.ones(len(edges)), np.transpose(edges)), (inverse.size, inverse.size))
    count, expected = connected_components(graph, directed=False)
    found = surfaces(inverse, 1.1)
    assert len(np.unique(found)) == count > 10
    assert len(np.unique(np.stack([found.ravel(), expected]), axis=1).T) == count, "each is one of the others"
    assert (found.ravel() <= number.ravel()).all() and (found.ravel()[found.ravel()] == found.ravel()).all()


def test_a_value_stands_or_falls_with_its_surface() -> None:
    inverse = np.full((20, 30), 0.1, np.float32)
    inverse[5:11, 8:15] = 1.0  # a part that is wrong, apart from what is around it
    inverse[3, 3] = 0.01  # a value that is wrong by itself
    inverse[15:, :10] = NONE
    trust = np.full(inverse.shape, 255, np.uint8)
    trust[inverse != np.float32(0.1)] = 0
    trust[0:4, 20:] = 10  # contradicted, but the wall goes on there
    weight = np.ones(inverse.shape, np.float32)
    now = trusted_whole(inverse, trust, weight) >= LEAST_TRUST
    assert np.array_equal(now, inverse == np.float32(0.1))
    trust[inverse == np.float32(0.1)] = 0
    trust[12:14, 12:29] = 255
    now = trusted_whole(inverse, trust, weight) >= LEAST_TRUST
    assert np.array_equal(now, trust >= LEAST_TRUST), "where most is contradicted, values stand by themselves"
    weight[trust == 0] = 0.01
    assert np.array_equal(trusted_whole(inverse, trust, weight) >= LEAST_TRUST, inverse == np.float32(0.1))


@pytest.mark.parametrize("seed", [0, 1])
def test_the_kernels_equal_their_slow_twin(seed: int) -> None:
    random = np.random.default_rng(seed)
    inverse, other = (
        np.where(random.random(SIZE) < 0.7, random.choice([0.02, 0.1, 0.12, 0.6], SIZE), NONE).astype(np.float32)
        for _ in range(2)
    )
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[1, :3, 3] = (0.2, 0.1, 1.0)
    there, here = (between(CAMERA, poses[a], CAMERA, poses[1 - a]) for a in (0, 1))
    voter = Voter(other, random.random(SIZE, dtype=np.float32), here, there)
    ballot = np.zeros((2, *SIZE), np.float32)
    vote(inverse, voter, RULES, ballot)
    np.testing.assert_allclose(ballot, slow.vote(inverse, voter, RULES), rtol=1e-4, atol=1e-5)
    assert (ballot > 0).any(axis=(1, 2)).all()
    shared = np.zeros_like(ballot)
    pool(inverse, ballot, RULES, 0, SIZE[0], shared)
    expected = slow.pool(inverse, ballot, RULES, STRIDE)
    np.testing.assert_allclose(shared[:, inverse > 0], expected[:, inverse > 0], rtol=1e-4, atol=1e-4)
