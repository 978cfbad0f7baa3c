"""A drive far from the world's zero, in UTM say, gives what the same drive near zero gives, and exact coordinates."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from factories import write_folder
from hypothesis import given
from hypothesis import strategies as st

from nerf import checkpoint
from nerf.config import FitConfig, ModelConfig
from nerf.export import CloudConfig, write_cloud
from nerf.prepare import SceneConfig
from nerf.run import Run, begin, open_run
from nerf.sample import SamplerConfig
from nerf.view.stage import open_stage
from priors import origin
from priors.drive_around import DriveAround
from priors.drives import open_drive
from priors.types import Drive, Frame

OFFSET_M = np.array([455000.3, 5428000.7, 110.0])
WHOLE = CloudConfig(opacity=0, agreement=1e9, farthest_m=1000, voxel_m=1e-3)
"""Takes every pixel of a field that has learned little."""


class Moved(DriveAround):
    """A drive whose world's zero lies elsewhere."""

    def __init__(self, drive: Drive, offset_m: Sequence[float]) -> None:
        super().__init__(drive)
        self.offset_m = offset_m

    def __getitem__(self, index: int) -> Frame:
        frame = self.drive[index]
        assert frame.T_world_cam is not None
        return replace(frame, T_world_cam=moved(frame.T_world_cam, self.offset_m))

    def fingerprint(self) -> str:
        return self.drive.fingerprint() + str(self.offset_m)


def moved(T_world_cam: np.ndarray, offset_m: Sequence[float]) -> np.ndarray:
    poses = np.array(T_world_cam, dtype=np.float64)
    poses[..., :3, 3] += offset_m
    return poses


def fitted(folder: Path, drive: Drive, steps: int = 3) -> Run:
    config = FitConfig(
        ModelConfig(width=16, log2_size=12, finest=64, sampler=SamplerConfig(render=16)), rays=256, steps=steps
    )
    run = begin(drive, None, SceneConfig(), config, folder)
    run.fit("cpu")
    return run


@pytest.fixture(scope="module")
def near(tmp_path_factory: pytest.TempPathFactory) -> Run:
    home = tmp_path_factory.mktemp("near")
    return fitted(home / "run", open_drive(write_folder(home / "mine")))


@pytest.fixture(scope="module")
def far(near: Run) -> Run:
    return fitted(near.folder.parent / "far" / "run", Moved(near.drive, OFFSET_M))


def xyz_m(path: Path) -> np.ndarray:
    """Read the places (n, 3) of a PLY file by its header."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    kinds = {"float": "<f4", "double": "<f8", "uchar": "u1"}
    fields = [line.split()[1:] for line in head.decode().splitlines() if line.startswith("property")]
    points = np.frombuffer(body, np.dtype([(name, kinds[kind]) for kind, name in fields]))
    return np.stack([points[name] for name in "xyz"], axis=1).astype(np.float64)


def test_the_origin_is_recorded_where_the_path_is_far_only(near: Run, far: Run) -> None:
    assert near.scene.origin_m == checkpoint.origin_of(near.folder) == origin.NONE
    assert far.scene.origin_m == checkpoint.origin_of(far.folder) == (455000, 5428001, 111)
    assert np.array_equal(near.scene.T_world_cam, [near.drive[i].T_world_cam for i in range(len(near.drive))])
    whole = moved(far.scene.T_world_cam, far.scene.origin_m)
    assert np.array_equal(whole, [far.drive[i].T_world_cam for i in range(len(far.drive))])


def test_a_far_drive_is_learned_as_the_near_one(near: Run, far: Run) -> None:
    pose = near.scene.T_world_cam[1]
    one = near.open_model("cpu").render(pose, near.scene.camera)
    two = far.open_model("cpu").render(moved(pose, OFFSET_M), far.scene.camera)
    assert np.abs(one.rgb - two.rgb).max() < 1e-3
    assert np.abs(one.depth_m - two.depth_m).max() < 1e-3 * one.depth_m.max()


def test_rays_of_a_far_drive_start_where_the_cameras_are(near: Run, far: Run) -> None:
    one, two = (run.scene.draw(64, 0, 0) for run in (near, far))
    shift_m = (one.origins_m - two.origins_m).numpy().astype(np.float64)
    assert np.abs(shift_m - (np.array(far.scene.origin_m) - OFFSET_M)).max() < 1e-6
    assert np.array_equal(one.directions, two.directions)


def test_the_cloud_of_a_far_drive_is_the_near_one_s_moved(near: Run, far: Run, tmp_path: Path) -> None:
    model = near.open_model("cpu")
    near_m = cloud(tmp_path / "near.ply", model.render, near)
    far_m = cloud(tmp_path / "far.ply", lambda pose, camera: model.render(moved(pose, -OFFSET_M), camera), far)
    assert len(far_m) == len(near_m) > 500
    assert b"property float x" in (tmp_path / "near.ply").read_bytes()
    assert b"property double x" in (tmp_path / "far.ply").read_bytes()
    assert np.abs(far_m - OFFSET_M - near_m).max() < 1e-3


def cloud(path: Path, render: Any, run: Run) -> np.ndarray:
    views = run.viewpoints("0:1")
    write_cloud(path, render, views.camera, views.T_world_cam, WHOLE)
    return xyz_m(path)


def test_a_view_without_the_drive_begins_where_its_camera_was(far: Run) -> None:
    elsewhere = replace(far.config, drive={**far.config.drive, "path": "gone/mine"})
    stage = open_stage(replace(far, source=None, config=elsewhere))
    pose = stage.track.pose(0)
    assert stage.drive is None and pose is not None
    assert np.abs(stage.track.unshifted(pose) - far.drive[0].T_world_cam).max() < 1e-8


def test_a_far_run_that_began_without_an_origin_goes_on_without_one(far: Run, tmp_path: Path) -> None:
    model = checkpoint.open_model(far.folder)
    run = begin(far.drive, None, SceneConfig(), replace(far.config.fit, steps=4), tmp_path / "run")
    checkpoint.save(run.folder, model, checkpoint.Spent(3, 1.0))
    assert run.scene.origin_m == origin.NONE
    run.fit("cpu")
    assert checkpoint.spent(run.folder).step == 4
    assert checkpoint.origin_of(open_run(run.folder).folder) == origin.NONE
    pose = run.scene.T_world_cam[0]
    ours = run.open_model("cpu").render(pose, run.scene.camera)
    assert np.array_equal(ours.rgb, checkpoint.open_model(run.folder).render(pose, run.scene.camera).rgb)


@given(st.lists(st.tuples(*[st.floats(-1e7, 1e7)] * 3), min_size=1, max_size=5))
def test_what_is_taken_off_leaves_the_path_as_small_as_it_is(places_m: list[tuple[float, float, float]]) -> None:
    poses = np.tile(np.eye(4), (len(places_m), 1, 1))
    poses[:, :3, 3] = places_m
    taken_m = origin.origin_of(poses)
    left_m = origin.without(taken_m, poses)[:, :3, 3]
    if np.abs(places_m).max() <= origin.FAR_M:
        assert taken_m == origin.NONE
    else:
        assert all(value == round(value) for value in taken_m)
        assert np.abs(left_m).max() <= np.ptp(places_m, axis=0).max() / 2 + 0.51
    assert np.abs(left_m + taken_m - places_m).max() <= 1e-8


def test_no_pose_has_no_origin() -> None:
    assert origin.origin_of(np.zeros((0, 4, 4))) == origin.NONE
