"""What the completion network learns from: scenes, what is shown of them, the drive's accumulated truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from test_mffnet import CAMERA, T_CAM_LIDAR, F, road

from priors.errors import DataError
from priors.learn import lidar_scene, pair_file
from priors.learn.accumulated_lidar import agrees
from priors.learn.completion import CompletionConfig, CompletionTask
from priors.learn.lidar_dropout import Density, drop_points
from priors.learn.lidar_odometry import align
from priors.learn.lidar_scene import LidarScene
from priors.learn.stereo_pair import Sensors, StereoPair
from priors.types import Camera


def scene(real: bool = False, seed: int = 0) -> LidarScene:
    """Scan lines on a road and a box that stands on it."""
    truth_m = road((288, 576))
    truth_m[60:160, 200:260] = 3.0
    rng = np.random.default_rng(seed)
    row, column = (grid.ravel() for grid in np.meshgrid(np.arange(40, 288, 5), np.arange(1, 576, 3), indexing="ij"))
    z = truth_m[row, column]
    camera = Camera(np.array([[300.0, 0, 280], [0, 300, 90], [0, 0, 1]]), (288, 576))
    points = np.stack([(column - 280) * z / 300, (row - 90) * z / 300, z], axis=1).astype(F)
    picture = rng.integers(0, 255, (288, 576, 3)).astype(np.uint8)
    return LidarScene(picture, camera, T_CAM_LIDAR, points, ((row - 40) // 5).astype(np.uint8), truth_m, real)


def test_points_fall_where_the_truth_is() -> None:
    sparse_m = lidar_scene.splat(scene().points_m, scene().camera)
    assert (sparse_m > 0).sum() == len(scene().points_m)
    np.testing.assert_allclose(sparse_m[sparse_m > 0], scene().truth_m[sparse_m > 0], rtol=1e-5)


def test_the_nearer_point_of_two_stays() -> None:
    points = np.array([[0, 0, 9.0], [0, 0, 4.0], [0, 0, 20.0]], F)
    assert lidar_scene.splat(points, CAMERA)[30, 70] == 4


@pytest.mark.parametrize("change", ["crop", "flip", "both"])
def test_changed_scenes_still_agree_with_their_truth(change: str) -> None:
    changed = scene()
    if change != "flip":
        changed = lidar_scene.crop(changed, 20, 50, (256, 512))
    if change != "crop":
        changed = lidar_scene.flip(changed)
    sparse_m = lidar_scene.splat(changed.points_m, changed.camera)
    assert changed.image.shape == (*changed.camera.size, 3) and (sparse_m > 0).sum() > 5000
    np.testing.assert_allclose(sparse_m[sparse_m > 0], changed.truth_m[sparse_m > 0], rtol=1e-5)


def test_rescaled_scenes_look_the_same() -> None:
    near = lidar_scene.rescale(scene(), 0.5)
    far = lidar_scene.splat(scene().points_m, scene().camera)
    np.testing.assert_allclose(lidar_scene.splat(near.points_m, near.camera), 0.5 * far, rtol=1e-5)
    np.testing.assert_allclose(near.truth_m, 0.5 * scene().truth_m)


@pytest.mark.parametrize("every", [1, 2, 8])
def test_lines_are_left_out(every: int) -> None:
    shown = drop_points(scene(), np.random.default_rng(0), Density(every))
    rows = np.unique(np.nonzero(shown.sparse_m)[0])
    assert np.array_equal(rows, np.arange(40, 288, 5)[::every])
    assert shown.weight[100, 300] == 1 and shown.weight[10, 300] < 0.1
    assert 0 < shown.weight[100, 200] < 1  # at the box's outline


def test_real_truth_is_what_was_not_shown_and_what_others_saw() -> None:
    unseen = replace(scene(real=True), truth_m=np.zeros((288, 576), F))
    shown = drop_points(unseen, np.random.default_rng(0), Density(every=2))
    known = shown.weight > 0
    assert known.any() and not (known & (shown.sparse_m > 0)).any()
    np.testing.assert_allclose(shown.truth_m[known], scene().truth_m[known], rtol=1e-5)


def test_values_that_the_own_sweep_denies() -> None:
    own_m = np.zeros((60, 60), F)
    own_m[::4, ::4] = 10
    own_m[::4, 32::4] = 20
    seen_m = np.full((60, 60), 15, F)
    kept = agrees(seen_m, own_m)
    assert kept[30, 30] and not kept[30, 5] and not kept[30, 55]
    assert not agrees(seen_m, np.zeros((60, 60), F)).any()


def test_a_sweep_finds_where_it_stands() -> None:
    rng = np.random.default_rng(0)
    floor = np.stack([rng.uniform(0, 20, 3000), rng.uniform(-8, 8, 3000), np.full(3000, -1.7)], axis=1)
    wall = np.stack([rng.uniform(0, 20, 2000), np.full(2000, 6.0), rng.uniform(-1.7, 4, 2000)], axis=1)
    front = np.stack([np.full(1500, 19.0), rng.uniform(-8, 6, 1500), rng.uniform(-1.7, 4, 1500)], axis=1)
    fixed = np.concatenate([floor, wall, front])
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0.004, -0.006, 0.02]).as_matrix()
    T[:3, 3] = 0.4, -0.1, 0.03
    moving = (fixed[rng.random(len(fixed)) < 0.8] - T[:3, 3]) @ T[:3, :3]
    found = align(moving, fixed, np.eye(4))
    np.testing.assert_allclose(found, T, atol=2e-3)


def write_samples(tmp_path: Path) -> Path:
    """Two samples to train on and one to validate on."""
    for number in (0, 1, 72):
        one = scene(seed=number)
        disparity_px = (300 * 0.54 / one.truth_m).astype(F)
        sky = np.zeros((288, 576), bool)
        sensors = Sensors(one.camera, 0.54, one.points_m, one.beam)
        everywhere = np.ones(sky.shape, F)
        rendered = StereoPair(one.image, one.image, disparity_px, sky, everywhere, "street", sensors)
        pair_file.write(tmp_path / "street" / f"{number:06d}.npz", rendered)
    return tmp_path / "street"


@pytest.fixture
def street(tmp_path: Path) -> Path:
    return write_samples(tmp_path)


def test_the_task_is_decided_by_its_arguments_and_learns(street: Path) -> None:
    task = CompletionTask(CompletionConfig(street, batch=2, size="s"))
    assert [len(shown) for shown in task.held_back().values()] == [1]
    first, again = (task.batch(3, np.random.default_rng([0, 3])) for _ in range(2))
    assert all(torch.equal(first[name], again[name]) for name in first)
    assert first["image"].shape == (2, 3, 192, 448) and all(torch.isfinite(value).all() for value in first.values())
    first["truth_m"] *= 1.2  # the pre-fill is wrong everywhere, and the network can tell by how much
    optimiser = torch.optim.Adam(task.net.parameters(), 3e-3)
    losses = []
    for _ in range(5):
        loss, _ = task.loss(first)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.9 * losses[0]


def test_validation_of_an_untrained_network_is_the_pre_fill(street: Path) -> None:
    task = CompletionTask(CompletionConfig(street, size="s"))
    with torch.inference_mode():
        found = task.validate(task.net.eval())
        pictures = task.pictures(task.net)
    assert found["error"] == pytest.approx(1, rel=1e-3)
    assert found["street_64lines_mae"] == pytest.approx(found["street_64lines_mae_fill"], rel=1e-3)
    assert found["street_64lines_mae"] > 0
    assert pictures["street_64lines"].shape == (3 * 288, 2 * 576, 3)


def test_a_folder_without_samples(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no samples to train on"):
        CompletionTask(CompletionConfig(tmp_path))
