"""nerfstudio, COLMAP and 3DGS exports, read as their documents say: the prior's depth, the drive's poses and camera."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from exported import Model, read_ply, truth_prior, views_of
from factories import write_folder
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from test_export_views import FAR_M, Moved

from priors.cache import Prior
from priors.drives import open_drive
from priors.errors import DataError
from priors.export import colmap, graphdeco, nerfstudio
from priors.export.fusion import FusionConfig
from priors.export.nerfstudio import NerfstudioConfig
from priors.filters import Filters
from priors.geometry import project, rays
from priors.types import Camera, Depth, Drive, Frame

pytestmark = pytest.mark.datasets
FUSION = FusionConfig(voxel_m=0.5, views=1)


@pytest.fixture
def drive(street_folder: Path) -> Drive:
    """The street: its poses turn, and its principal point is not in the middle."""
    calib = json.loads((street_folder / "calib.json").read_text())
    (street_folder / "calib.json").write_text(json.dumps({**calib, "cx": calib["cx"] - 7.3, "cy": calib["cy"] + 4.4}))
    return open_drive(street_folder)


@pytest.fixture
def prior(drive: Drive, tmp_path: Path) -> Prior:
    return truth_prior(drive, tmp_path / "cache")


def frames_of(drive: Drive) -> dict[str, Frame]:
    return {drive[index].id: drive[index] for index in range(len(drive))}


def read(path: Path) -> np.ndarray:
    """Read an image file as it is."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    return image


# --- COLMAP


def test_a_colmap_model_is_the_drive(drive: Drive, prior: Prior, tmp_path: Path) -> None:
    views = views_of(prior, drive, "1:5")
    lines = colmap.write(tmp_path / "out", views, FUSION)
    model = Model(tmp_path / "out" / "sparse" / "0")
    assert sorted(model.images) == [f"{id_}.png" for id_ in views.ids] and "4 images" in lines[0]
    for id_, frame in frames_of(drive).items():
        if id_ in views.ids:
            np.testing.assert_allclose(model.T_world_cam(f"{id_}.png"), frame.T_world_cam, atol=1e-6)
            half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
            np.testing.assert_allclose(model.K(f"{id_}.png"), frame.camera.K + half, atol=1e-9)
            assert np.array_equal(read(tmp_path / "out" / "images" / f"{id_}.png")[..., ::-1], frame.image())
    assert "0.5, 0.5" in (tmp_path / "out" / "README.txt").read_text()


def test_colmap_points_lie_on_the_maps_and_tracks_join(drive: Drive, prior: Prior, tmp_path: Path) -> None:
    colmap.write(tmp_path / "out", views_of(prior, drive), FUSION)
    model, frames = Model(tmp_path / "out" / "sparse" / "0"), frames_of(drive)
    errors: dict[int, list[float]] = {number: [] for number in model.points}
    lengths = []
    for name, (_, _, image_id) in model.images.items():
        frame, seen = frames[name[:-4]], model.seen[image_id]
        xy, ids = seen[:, :2], seen[:, 2].astype(int)
        xyz_m = np.array([model.points[number][0] for number in ids])
        T = model.T_world_cam(name)
        uv_px, depth_m = project(frame.camera, (xyz_m - T[:3, 3]) @ T[:3, :3])
        columns, rows = (xy - 0.5).astype(int).T
        assert np.abs(depth_m - prior.read(frame.id).depth_m[rows, columns]).max() < 0.5 * 3**0.5 + 1e-3
        for number, error in zip(ids, np.linalg.norm(uv_px + 0.5 - xy, axis=1), strict=True):
            errors[number].append(error)
        for position, number in enumerate(ids):
            assert [image_id, position] in model.points[number][3].reshape(-1, 2).tolist()
    for number, (_, _, error, track) in model.points.items():
        assert error == pytest.approx(np.mean(errors[number]), abs=1e-3, rel=1e-3)
        assert len(track) == 2 * len(errors[number]) > 0
        lengths.append(len(errors[number]))
    assert max(lengths) == len(drive)


def test_a_colours_point_is_its_nearest_pixels(drive: Drive, prior: Prior, tmp_path: Path) -> None:
    colmap.write(tmp_path / "out", views_of(prior, drive, "0:1"), FusionConfig(voxel_m=0.01))
    model = Model(tmp_path / "out" / "sparse" / "0")
    frame = drive[0]
    (columns, rows), ids = (model.seen[1][:, :2].T - 0.5).astype(int), model.seen[1][:, 2].astype(int)
    assert np.array_equal([model.points[number][1] for number in ids], frame.image()[rows, columns])


@given(
    st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1), st.tuples(*[st.floats(-1e3, 1e3)] * 3)
)
def test_poses_go_to_colmap_and_back(quaternion: tuple[float, ...], place_m: tuple[float, ...]) -> None:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = Rotation.from_quat(quaternion).as_matrix(), place_m
    wxyz, t_m = colmap.world_to_camera(T)
    assert wxyz[0] >= 0 and np.linalg.norm(wxyz) == pytest.approx(1)
    R_cam_world = Rotation.from_quat(wxyz[[1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(R_cam_world, T[:3, :3].T, atol=1e-9)
    np.testing.assert_allclose(-R_cam_world.T @ t_m, place_m, atol=1e-6)


def test_a_far_drive_is_moved_and_it_is_told(drive: Drive, prior: Prior, tmp_path: Path) -> None:
    views = views_of(prior, Moved(drive))
    colmap.write(tmp_path / "colmap", views, FUSION)
    nerfstudio.write(tmp_path / "ns", views, NerfstudioConfig(), FUSION)
    model = Model(tmp_path / "colmap" / "sparse" / "0")
    transforms = json.loads((tmp_path / "ns" / "transforms.json").read_text())
    moved_m = np.array(transforms["applied_transform"])[:, 3]
    assert np.array_equal(-moved_m, views.origin_m)
    for entry in transforms["frames"]:
        name = Path(entry["file_path"]).name
        frame = frames_of(drive)[name[:-4]]
        for T in (model.T_world_cam(name), np.array(entry["transform_matrix"])):
            np.testing.assert_allclose(T[:3, 3] - moved_m, frame.pose()[:3, 3] + FAR_M, atol=1e-6)
    told = f"+ ({views.origin_m[0]:.0f}, {views.origin_m[1]:.0f}, {views.origin_m[2]:.0f}) m"
    assert all(told in (tmp_path / kind / "README.txt").read_text() for kind in ("colmap", "ns"))


# --- nerfstudio


@pytest.mark.parametrize(("unit", "metres", "farthest_m"), [("mm", 0.001, 65.535), ("1/256", 1 / 256, 255.99)])
def test_nerfstudio_reads_depth_and_poses(
    drive: Drive, prior: Prior, tmp_path: Path, unit: str, metres: float, farthest_m: float
) -> None:
    out = tmp_path / "out"
    lines = nerfstudio.write(out, views_of(prior, drive), NerfstudioConfig(depth_unit=unit), FUSION)  # type: ignore[arg-type]
    transforms = json.loads((out / "transforms.json").read_text())
    camera = drive[0].camera
    assert (transforms["w"], transforms["h"]) == camera.size[::-1]
    assert [transforms[key] for key in ("fl_x", "fl_y")] == pytest.approx([camera.K[0, 0], camera.K[1, 1]])
    assert [transforms[key] for key in ("cx", "cy")] == pytest.approx([camera.K[0, 2] + 0.5, camera.K[1, 2] + 0.5])
    assert len(transforms["frames"]) == len(drive)
    for entry in transforms["frames"]:
        frame = frames_of(drive)[Path(entry["file_path"]).stem]
        assert "fl_x" not in entry and "mask_path" not in entry
        assert np.array_equal(read(out / entry["file_path"])[..., ::-1], frame.image())
        codes, depth_m = read(out / entry["depth_file_path"]), prior.read(frame.id).depth_m
        held = depth_m <= farthest_m
        assert codes.dtype == np.uint16 and not codes[~held].any()
        assert np.abs(codes[held] * metres - depth_m[held]).max() <= metres / 2 + 1e-5
        T = np.array(entry["transform_matrix"])
        np.testing.assert_allclose(T @ np.diag([1, -1, -1, 1]), frame.T_world_cam, atol=1e-9)
        # a pixel's ray by nerfstudio's formula: ((u + 0.5 - cx) / fx, -(v + 0.5 - cy) / fy, -1)
        u, v = 17, 40
        local = np.array(
            [(u + 0.5 - transforms["cx"]) / transforms["fl_x"], (transforms["cy"] - v - 0.5) / transforms["fl_y"], -1]
        )
        np.testing.assert_allclose(T[:3, :3] @ local, frame.pose()[:3, :3] @ rays(camera)[v, u], atol=1e-9)
    assert f"--depth-unit-scale-factor {metres!r} " in lines[-1]
    assert lines[-1] in (out / "README.txt").read_text()
    far = sum(int(np.count_nonzero(prior.read(id_).depth_m > farthest_m)) for id_ in drive.ids)
    assert far > 0 if unit == "mm" else far == 0
    assert any(f"{far} depths are too far" in line for line in lines) == (far > 0)
    points, _ = read_ply(out / transforms["ply_file_path"])
    assert len(points) > 1000 and {"x", "red"} <= set(points.dtype.names or ())


@pytest.mark.parametrize("masks", ["sky", "no-depth"])
def test_masks_are_black_where_nothing_is_sampled(drive: Drive, prior: Prior, tmp_path: Path, masks: str) -> None:
    views = views_of(prior, drive, "0:2", Filters(clip=30))
    nerfstudio.write(tmp_path / "out", views, NerfstudioConfig(masks=masks), FUSION)  # type: ignore[arg-type]
    for entry in json.loads((tmp_path / "out" / "transforms.json").read_text())["frames"]:
        mask, frame = read(tmp_path / "out" / entry["mask_path"]), frames_of(drive)[Path(entry["file_path"]).stem]
        assert mask.dtype == np.uint8 and set(np.unique(mask)) == {0, 255}
        if masks == "no-depth":
            depth_m = prior.read(frame.id).depth_m
            assert np.array_equal(mask == 255, (depth_m > 0) & (depth_m <= 30))
        else:  # the street's truth has depth of all that is no sky
            assert np.mean((mask == 0) == (prior.read(frame.id).depth_m == 0)) > 0.95


def test_what_is_there_is_not_written_again(drive: Drive, prior: Prior, tmp_path: Path, full_disk: Callable) -> None:
    out, views = tmp_path / "out", views_of(prior, drive)
    with full_disk(30_000), pytest.raises(OSError, match=r"points3D\.ply"):
        nerfstudio.write(out, views, NerfstudioConfig(), FusionConfig(voxel_m=0.1, views=1))
    assert not (out / "transforms.json").exists() and not (out / "README.txt").exists()
    assert not list(out.glob("**/.*"))
    first = {path: path.stat().st_mtime_ns for path in out.glob("*/*.png")}
    assert len(first) == 2 * len(drive)
    nerfstudio.write(out, views, NerfstudioConfig(), FusionConfig(voxel_m=0.1, views=1))
    assert {path: path.stat().st_mtime_ns for path in first} == first
    assert (out / "README.txt").exists()


# --- 3DGS


def trainers_inverse(out: Path, name: str) -> np.ndarray:
    """Read inverse depth, 1/m, as graphdeco's trainer does; None where it would not use the image."""
    params = json.loads((out / "sparse" / "0" / "depth_params.json").read_text())
    median = np.median([entry["scale"] for entry in params.values() if entry["scale"] > 0])
    own = params[name]
    assert 0.2 * median <= own["scale"] <= 5 * median, "the trainer would leave the image out"
    code = read(out / "depths" / f"{name}.png")
    assert code.dtype == np.uint16
    return code.astype(np.float32) / float(2**16) * own["scale"] + own["offset"]


def test_the_trainer_s_inverse_depth_is_the_prior_s(drive: Drive, prior: Prior, tmp_path: Path) -> None:
    out = tmp_path / "out"
    lines = graphdeco.write(out, views_of(prior, drive), FUSION)
    model, frames = Model(out / "sparse" / "0"), frames_of(drive)
    assert lines[-1] == f"python train.py -s {out} -d depths"
    scale = next(iter(json.loads((out / "sparse" / "0" / "depth_params.json").read_text()).values()))["scale"]
    nearest_m = min(float(prior.read(id_).depth_m[prior.read(id_).valid].min()) for id_ in drive.ids)
    assert scale >= 1 / nearest_m * 65535 / 65536
    for name in model.images:
        frame, K = frames[name[:-4]], model.K(name)
        inverse = trainers_inverse(out, frame.id)
        rows, columns = inverse.shape
        assert read(out / "images" / name).shape[:2] == (rows, columns)
        assert abs(K[0, 2] - columns / 2) <= 0.25 + 1e-9 and abs(K[1, 2] - rows / 2) <= 0.25 + 1e-9
        left, top = (round(a - b) for a, b in zip(frame.camera.K[:2, 2] + 0.5, K[:2, 2], strict=True))
        np.testing.assert_allclose(frame.camera.K[:2, 2] + 0.5 - K[:2, 2], (left, top), atol=1e-9)
        window = slice(top, top + rows), slice(left, left + columns)
        assert np.array_equal(read(out / "images" / name)[..., ::-1], frame.image()[window])
        depth_m = prior.read(frame.id).depth_m[window]
        known = depth_m > 0
        assert np.abs(inverse[known] - 1 / depth_m[known]).max() <= scale / 65536 / 2 * 1.01
        np.testing.assert_allclose(model.T_world_cam(name), frame.T_world_cam, atol=1e-6)
    points, _ = read_ply(out / "sparse" / "0" / "points3D.ply")
    assert points.dtype.names == ("x", "y", "z", "nx", "ny", "nz", "red", "green", "blue")
    assert len(points) == len(model.points)


@given(st.integers(1, 60), st.floats(-0.4, 59.4))
def test_the_window_s_middle_is_the_principal_point(length: int, centre_px: float) -> None:
    first, count = graphdeco._window(centre_px, length)
    assert first >= 0 and first + count <= length
    if count:
        assert abs(first + (count - 1) / 2 - centre_px) <= 0.25 + 1e-9
        assert first == 0 or first + count == length
    else:
        assert not 0 <= centre_px <= length - 1


def test_gaps_take_the_nearest_value_and_the_sky_none() -> None:
    rng = np.random.default_rng(0)
    depth_m = np.where(rng.random((12, 15)) < 0.2, rng.uniform(2, 50, (12, 15)), 0).astype(np.float32)
    sky = np.zeros((12, 15), bool)
    sky[:4] = True
    inverse = graphdeco.fill(Depth(depth_m), sky)
    known = np.argwhere(depth_m > 0)
    for row, column in np.ndindex(12, 15):
        if depth_m[row, column] > 0:
            assert inverse[row, column] == pytest.approx(1 / depth_m[row, column], rel=1e-6)
        elif sky[row, column]:
            assert inverse[row, column] == 0
        else:
            far = ((known - (row, column)) ** 2).sum(axis=1)
            nearest = {round(float(1 / depth_m[r, c]), 6) for r, c in known[far == far.min()]}
            assert round(float(inverse[row, column]), 6) in nearest
    assert not graphdeco.fill(Depth(np.zeros((3, 3), np.float32)), np.zeros((3, 3), bool)).any()


def test_a_sparse_prior_is_no_prior_for_3dgs(drive: Drive, prior: Prior, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="dense prior"):
        graphdeco.write(tmp_path / "out", views_of(prior, drive, None, Filters(density=0.3)), FUSION)
    lines = graphdeco.write(tmp_path / "out", views_of(prior, drive, None, Filters(density=0.7)), FUSION)
    assert any("of the pixels below the sky had no depth" in line for line in lines)


def test_cameras_that_differ_stand_each_for_itself(tmp_path: Path) -> None:
    own = open_drive(write_folder(tmp_path / "mine"))

    class Zoomed(Moved):
        def __getitem__(self, index: int) -> Frame:
            from dataclasses import replace

            frame = self.drive[index]
            K = frame.camera.K.copy()
            K[0, 0] += index
            return replace(frame, camera=Camera(K, frame.camera.size))

    views = views_of(truth_prior(own, tmp_path / "cache"), Zoomed(own))
    colmap.write(tmp_path / "colmap", views, FUSION)
    nerfstudio.write(tmp_path / "ns", views, NerfstudioConfig(), FUSION)
    model = Model(tmp_path / "colmap" / "sparse" / "0")
    transforms = json.loads((tmp_path / "ns" / "transforms.json").read_text())
    assert [model.K(f"{id_}.png")[0, 0] for id_ in "abc"] == [200, 201, 202]
    assert [entry["fl_x"] for entry in transforms["frames"]] == [200, 201, 202] and "fl_x" not in transforms
