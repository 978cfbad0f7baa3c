"""Exports go round: what is written is read by our own readers, and by the packages of those who consume it."""

from pathlib import Path

import numpy as np
import pytest
from exported import read_ply, truth_prior, views_of
from independent import parse

from priors.cache import Prior
from priors.drives import open_drive
from priors.export import colmap, graphdeco, nerfstudio, ply
from priors.export.fusion import FusionConfig, fuse
from priors.export.nerfstudio import NerfstudioConfig
from priors.geometry import invert
from priors.types import Drive

pytestmark = pytest.mark.datasets
FUSION = FusionConfig(voxel_m=0.5, views=1)


@pytest.fixture
def drive(street_folder: Path) -> Drive:
    return open_drive(street_folder)


@pytest.fixture
def prior(drive: Drive, tmp_path: Path) -> Prior:
    return truth_prior(drive, tmp_path / "cache")


@pytest.mark.parametrize(("unit", "step_m"), [("mm", 0.001), ("1/256", 1 / 256)])
def test_nerfstudio_data_is_a_drive_again(drive: Drive, prior: Prior, tmp_path: Path, unit: str, step_m: float) -> None:
    nerfstudio.write(tmp_path / "out", views_of(prior, drive), NerfstudioConfig(depth_unit=unit), FUSION)  # type: ignore[arg-type]
    again = open_drive(tmp_path / "out")
    assert list(again.ids) == list(drive.ids)
    for index, id_ in enumerate(drive.ids):
        ours, theirs = drive[index], again[index]
        np.testing.assert_allclose(theirs.pose(), ours.pose(), atol=1e-6)
        np.testing.assert_allclose(theirs.camera.K, ours.camera.K, atol=1e-9)
        assert np.array_equal(theirs.image(), ours.image())
        depth_m, found_m = prior.read(id_).depth_m, theirs.truth().depth_m
        held = depth_m < 65535 * step_m
        assert np.abs(found_m - depth_m)[held].max() <= step_m / 2 + 1e-5
        assert not found_m[~held].any()


def test_a_colmap_model_is_a_drive_again(drive: Drive, prior: Prior, tmp_path: Path) -> None:
    colmap.write(tmp_path / "out", views_of(prior, drive), FusionConfig(voxel_m=0.1, reach_m=20))
    again = open_drive(tmp_path / "out")
    assert list(again.ids) == list(drive.ids)
    for index, id_ in enumerate(drive.ids):
        ours, theirs = drive[index], again[index]
        np.testing.assert_allclose(theirs.pose(), ours.pose(), atol=1e-6)
        np.testing.assert_allclose(theirs.camera.K, ours.camera.K, atol=1e-9)
        assert np.array_equal(theirs.image(), ours.image())
        sparse_m, depth_m = theirs.sparse().depth_m, prior.read(id_).depth_m
        known = (sparse_m > 0) & (depth_m > 0)
        assert np.count_nonzero(known) > 1000
        assert np.percentile(np.abs(sparse_m - depth_m)[known], 90) < 0.1 * 3**0.5


def test_a_3dgs_folder_is_a_drive_again(drive: Drive, prior: Prior, tmp_path: Path) -> None:
    graphdeco.write(tmp_path / "out", views_of(prior, drive), FUSION)
    again = open_drive(tmp_path / "out")
    for index in range(len(drive)):
        np.testing.assert_allclose(again[index].pose(), drive[index].pose(), atol=1e-6)
        height, width = again[index].camera.size
        middle = np.array([width - 1, height - 1]) / 2
        assert np.abs(again[index].camera.K[:2, 2] - middle).max() <= 0.25 + 1e-9


def test_pycolmap_and_plyfile_read_what_was_written(drive: Drive, prior: Prior, tmp_path: Path) -> None:
    views = views_of(prior, drive)
    colmap.write(tmp_path / "out", views, FUSION)
    cloud = fuse(views, views.near_poses, FUSION)
    ply.write_ply(tmp_path / "a.ply", cloud.points)
    theirs = parse("read_exports.py", tmp_path / "out" / "sparse" / "0", tmp_path / "a.ply")
    model, points = theirs["model"], theirs["points"]
    assert len(model["images"]) == len(drive) and model["points"] == len(cloud.points)
    assert model["longest"] == cloud.points["views"].max() > 1
    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    for index, id_ in enumerate(drive.ids):
        found = model["images"][f"{id_}.png"]
        np.testing.assert_allclose(found["T_cam_world"], invert(drive[index].pose()), atol=1e-6)
        np.testing.assert_allclose(found["K"], drive[index].camera.K + half, atol=1e-9)
        assert found["error_px_of_single"] < 1e-3, "a point that one view sees lies on that view's pixel"
    own, _ = read_ply(tmp_path / "a.ply")
    assert points["count"] == len(own) and list(points["kinds"]) == list(own.dtype.names or ())
    assert points["first"] == [float(value) for value in own[0]]
