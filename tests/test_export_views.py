"""Exports' ground: which frames go out, where files may go, and many views as one cloud."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from exported import read_ply, truth_prior, views_of
from factories import write_folder
from hypothesis import given
from hypothesis import strategies as st

from priors import codecs
from priors.cache import Prior
from priors.drive_around import DriveAround
from priors.drives import open_drive
from priors.errors import DataError, UsageError
from priors.export import place, ply
from priors.export.fusion import SEEN, FusionConfig, cells_of, fuse, hash_of
from priors.filters import Filters
from priors.geometry import unproject
from priors.types import Drive, Frame

pytestmark = pytest.mark.datasets
FAR_M = np.array([455000.0, 5428000.0, 110.0])


class Without(DriveAround):
    """A drive one of whose frames has no pose."""

    def __getitem__(self, index: int) -> Frame:
        frame = self.drive[index]
        return replace(frame, T_world_cam=None, missing={"pose": "lost"}) if index == 1 else frame


class Moved(DriveAround):
    """A drive far from the world's zero."""

    def __getitem__(self, index: int) -> Frame:
        frame = self.drive[index]
        assert frame.T_world_cam is not None
        T_world_cam = frame.T_world_cam.copy()
        T_world_cam[:3, 3] += FAR_M
        return replace(frame, T_world_cam=T_world_cam)


@pytest.fixture
def drive(tmp_path: Path) -> Drive:
    return open_drive(write_folder(tmp_path / "mine"))


@pytest.fixture
def prior(drive: Drive, tmp_path: Path) -> Prior:
    return truth_prior(drive, tmp_path / "cache")


def test_frames_maps_and_filters_are_those_asked_for(drive: Drive, prior: Prior) -> None:
    views = views_of(prior, drive, "1:3", Filters(confidence=0.75))
    assert list(views.ids) == ["b", "c"]
    for view in views:
        whole = prior.read(view.frame.id)
        assert np.array_equal(view.depth.depth_m, np.where(whole.trust() >= 0.75, whole.depth_m, 0))
        assert 0 < view.depth.density < whole.density


def test_frames_without_a_pose_are_left_out_and_told(drive: Drive, prior: Prior) -> None:
    views = views_of(prior, Without(drive))
    assert list(views.ids) == ["a", "c"] and "lost" in views.unplaced["b"]
    with pytest.raises(DataError, match=r"no frame has a pose, the first: .*lost"):
        views_of(prior, Without(drive), "1")


def test_a_damaged_map_is_left_out_and_told(drive: Drive, prior: Prior) -> None:
    path = prior.depth_path("b")
    path.write_bytes(path.read_bytes()[:-40])
    views = views_of(prior, drive)
    assert [view.frame.id for view in views] == ["a", "c"]
    assert "damaged" in views.unread["b"]


def test_what_cannot_be_exported_is_told(drive: Drive, prior: Prior) -> None:
    with pytest.raises(DataError, match="no maps of mine in --frames 1:2"):
        prior.depth_path("b").unlink()
        views_of(prior, drive, "1:2")
    with pytest.raises(DataError, match=r"no frame can be exported, the first a: .*confidence"):
        list(views_of(truth_prior(drive, prior.folder.parent.parent / "other", False), drive, None, Filters(keep=0.5)))


def test_names_hold_no_white_space(tmp_path: Path) -> None:
    own = open_drive(write_folder(tmp_path / "mine", ["my photo 1", "my photo 2"]))
    views = views_of(truth_prior(own, tmp_path / "cache"), own)
    assert list(views.names.values()) == ["my_photo_1", "my_photo_2"]


# --- where files may go


def test_an_export_goes_on_and_another_is_refused(drive: Drive, prior: Prior, tmp_path: Path) -> None:
    views, folder = views_of(prior, drive), tmp_path / "out"
    asked = place.record(views, "colmap", {"voxel_m": 0.1})
    place.claim(folder, asked)
    place.claim(folder, place.record(views, "colmap", {"voxel_m": 0.2}))  # nothing was written yet
    place.claim(folder, asked)
    (folder / "images").mkdir()
    place.claim(folder, asked)
    for other in (
        place.record(views, "colmap", {"voxel_m": 0.2}),
        place.record(views_of(prior, drive, "0:2"), "colmap", {"voxel_m": 0.1}),
        place.record(views_of(prior, drive, None, Filters(clip=20)), "colmap", {"voxel_m": 0.1}),
    ):
        with pytest.raises(DataError, match=r"holds another export .* --out"):
            place.claim(folder, other)
    prior.write("a", prior.read("a").keep(np.eye(96, 240, dtype=bool)), 0.1)  # the map was made anew
    with pytest.raises(DataError, match="another export"):
        place.claim(folder, place.record(views_of(prior, drive), "colmap", {"voxel_m": 0.1}))
    assert json.loads((folder / place.NAME).read_text())["frames"] == ["a", "b", "c"]


def test_what_others_wrote_is_never_touched(drive: Drive, prior: Prior, tmp_path: Path) -> None:
    asked = place.record(views_of(prior, drive), "colmap", {})
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / "thesis.txt").write_text("mine")
    with pytest.raises(DataError, match="holds other files"):
        place.claim(tmp_path / "theirs", asked)
    assert [path.name for path in (tmp_path / "theirs").iterdir()] == ["thesis.txt"]
    with pytest.raises(DataError, match="is a file"):
        place.claim(tmp_path / "theirs" / "thesis.txt", asked)
    with pytest.raises(DataError, match="no export wrote it"):
        place.expect_ours(tmp_path / "theirs" / "thesis.txt")
    place.expect_ours(tmp_path / "new.ply")
    ply.write_ply(tmp_path / "new.ply", np.zeros(9000, SEEN), comments=place.heading(views_of(prior, drive)))
    place.expect_ours(tmp_path / "new.ply")


# --- one point a voxel


def by_loops(drive: Drive, prior: Prior, voxel_m: float) -> dict[tuple[int, ...], tuple[float, set[str]]]:
    """Voxel -> the least depth in it, and the frames that see it."""
    found: dict[tuple[int, ...], tuple[float, set[str]]] = {}
    for frame in (drive[index] for index in range(len(drive))):
        depth_m = prior.read(frame.id).depth_m
        T = frame.pose()
        for xyz in unproject(frame.camera, depth_m).astype(np.float64):
            place_m = np.float32(T[:3, :3] @ xyz + T[:3, 3])
            cell = tuple(np.floor(place_m / voxel_m).astype(int).tolist())
            least, seen = found.setdefault(cell, (np.inf, set()))
            seen.add(frame.id)
            found[cell] = (min(least, float(xyz[2])), seen)
    return found


def test_a_cloud_is_what_loops_make_of_it(tmp_path: Path) -> None:
    own = open_drive(write_folder(tmp_path / "mine", ["a", "b"]))
    prior = truth_prior(own, tmp_path / "cache")
    views = views_of(prior, own, None, Filters(sky_rows=0.8))
    for frame_id in own.ids:
        prior.write(frame_id, views.filters(prior.read(frame_id), own[0]), 0.1)
    wanted = by_loops(own, prior, 0.5)
    cloud = fuse(views_of(prior, own), views.near_poses, FusionConfig(voxel_m=0.5, views=1))
    cells = {tuple(np.floor(np.array([p["x"], p["y"], p["z"]]) / 0.5).astype(int).tolist()): p for p in cloud.points}
    assert len(cells) == len(cloud.points)
    alike = cells.keys() & wanted.keys()  # a point on a voxel's face may round to either side
    assert len(alike) > 0.99 * max(len(cells), len(wanted))
    for cell in alike:
        least, seen = wanted[cell]
        assert cells[cell]["depth"] == pytest.approx(least, rel=1e-5)
        assert cells[cell]["views"] == len(seen)
    both = fuse(views_of(prior, own), views.near_poses, FusionConfig(voxel_m=0.5, views=2))
    assert len(both.points) == sum(point["views"] == 2 for point in cloud.points) > 0
    usual = fuse(views_of(prior, own), views.near_poses, FusionConfig(voxel_m=0.5))
    assert np.array_equal(usual.points, both.points) and usual.least_views == 2
    alone = fuse(views_of(prior, own, "0:1"), views.near_poses, FusionConfig(voxel_m=0.5))
    assert len(alone.points) > 0 and alone.least_views == 1


def test_observations_are_the_pixels_that_see_a_voxel(drive: Drive, prior: Prior) -> None:
    views = views_of(prior, drive)
    cloud = fuse(views, views.near_poses, FusionConfig(voxel_m=0.3, views=1), most=500)
    assert len(cloud.points) == 500
    counts = np.zeros(500, int)
    for number, seen in cloud.seen_by.items():
        counts[seen.point] += 1
        assert len(np.unique(seen.point)) == len(seen.point)
        columns, rows = seen.uv_px.astype(int).T
        depth_m = prior.read(views.ids[number]).depth_m[rows, columns]
        xyz_m = (cloud.xyz_m()[seen.point] - views.near_poses[number][:3, 3]) @ views.near_poses[number][:3, :3]
        assert np.abs(xyz_m[:, 2] - depth_m).max() < 0.3 * 3**0.5
    assert np.array_equal(counts, cloud.points["views"])


@pytest.mark.parametrize("least_views", [1, 2])
def test_fewer_points_are_those_of_least_hash(
    drive: Drive, prior: Prior, least_views: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    views, config = views_of(prior, drive), FusionConfig(voxel_m=0.7, views=least_views)
    whole = fuse(views, views.near_poses, config, most=10**9)
    monkeypatch.setattr("priors.export.fusion._AT_ONCE", 100)  # merged after each view
    count = len(whole.points) // 2
    few = fuse(views, views.near_poses, config, most=count)
    hashes = hash_of(cells_of(whole.points, 0.7))
    wanted = whole.points[hashes <= np.sort(hashes)[count - 1]]
    assert len(few.points) == count > 20
    assert np.array_equal(few.points, wanted), "with the depth and the number of views that all views give"
    assert sum(len(seen.point) for seen in few.seen_by.values()) == few.points["views"].sum()


def test_hashes_are_even() -> None:
    hashes = hash_of(np.arange(100_000))
    assert len(np.unique(hashes)) == 100_000
    counts, _ = np.histogram(hashes / 2.0**64, 100, (0, 1))
    assert counts.min() > 850 and counts.max() < 1150


def test_a_cloud_without_points_says_what_to_do(drive: Drive, prior: Prior) -> None:
    views = views_of(prior, drive)
    with pytest.raises(DataError, match=r"no point within 0.1 m: .*--reach-m"):
        fuse(views, views.near_poses, FusionConfig(reach_m=0.1))


@given(
    st.lists(st.tuples(*[st.floats(-1000, 1000, width=32)] * 3), min_size=1, max_size=20),
    st.sampled_from([0.1, 0.5, 2.0]),
)
def test_voxels_are_told_apart_by_their_number(places: list[tuple[float, float, float]], voxel_m: float) -> None:
    points = np.array(places, dtype=[(axis, "<f4") for axis in "xyz"])
    rows = np.stack([np.floor(points[axis] / voxel_m) for axis in "xyz"], axis=1).astype(int)
    assert len(np.unique(cells_of(points, voxel_m))) == len(np.unique(rows, axis=0))


def test_far_points_are_doubles_in_the_drives_own_frame(drive: Drive, prior: Prior, tmp_path: Path) -> None:
    near, far = views_of(prior, drive), views_of(prior, Moved(drive))
    assert any(far.origin_m) and not any(near.origin_m)
    clouds = [fuse(views, views.near_poses, FusionConfig(voxel_m=0.5)) for views in (near, far)]
    ply.write_ply(tmp_path / "far.ply", clouds[1].points, far.origin_m)
    points, comments = read_ply(tmp_path / "far.ply")
    assert points.dtype["x"] == "<f8" and comments == list(ply.COMMENTS)
    offset_m = FAR_M - np.array(far.origin_m)
    wanted = fuse(near, near.T_world_cam + np.pad(offset_m[:, None], ((0, 1), (3, 0))), FusionConfig(voxel_m=0.5))
    xyz_m = np.stack([points[axis] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(xyz_m - FAR_M, wanted.xyz_m() - offset_m, atol=1e-4)


@pytest.mark.parametrize(
    "wrong", [{"voxel_m": 0}, {"voxel_m": float("nan")}, {"reach_m": -1}, {"views": 0}, {"points": 0}]
)
def test_settings_that_are_none_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(UsageError, match=f"--{next(iter(wrong)).replace('_', '-')}"):
        FusionConfig(**wrong)  # type: ignore[arg-type]


def test_a_full_disk_leaves_no_half_file(drive: Drive, prior: Prior, tmp_path: Path, full_disk: Callable) -> None:
    views = views_of(prior, drive)
    cloud = fuse(views, views.near_poses, FusionConfig(voxel_m=0.05, views=1))
    with full_disk(10_000), pytest.raises(OSError, match=r"new\.ply"):
        ply.write_ply(tmp_path / "new.ply", cloud.points)
    assert not list(tmp_path.glob("*new*"))
    codecs.write_image(tmp_path / "ok.png", np.zeros((2, 2), np.uint8))
