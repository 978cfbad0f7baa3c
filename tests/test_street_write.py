"""The street on disk: a KITTI raw drive that the ordinary reader reads."""

import json

import numpy as np
import pytest

from priors import geometry
from priors.drives import DriveOptions, open_drive
from priors.errors import DataError
from priors.geometry import untwist
from priors.street.street import Street
from priors.street.write import write_street

SIZE = (96, 320)
SEED, FRAMES = 11, 3


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    out = tmp_path_factory.mktemp("street")
    told = []
    write_street(out, FRAMES, SEED, SIZE, told.append, workers=2)
    assert sorted(told) == list(range(FRAMES))
    return out


@pytest.fixture(scope="module")
def drive(written):
    return open_drive(written)


def _files(folder):
    return {path.relative_to(folder): path for path in sorted(folder.rglob("*")) if path.is_file()}


def test_the_reader_recognises_it_and_finds_everything(drive):
    assert drive.describe()["dataset"] == "kitti_raw"
    assert list(drive.ids) == [f"{number:010d}" for number in range(FRAMES)]
    frame = drive[0]
    assert frame.baseline_m == pytest.approx(0.54)
    assert frame.image().shape == frame.other().shape == (*SIZE, 3)
    assert all(frame.has(what) for what in ("image", "other", "sweep", "truth", "sparse", "sky"))
    assert [drive[k].time_s for k in range(FRAMES)] == pytest.approx([0, 0.1, 0.2])


def test_poses_come_back_to_a_tenth_of_a_millimetre(drive):
    street = Street(SEED, length_m=80)
    first = geometry.invert(street.T_world_cam(0.0))
    for number in range(FRAMES):
        read = geometry.invert(drive[0].T_world_cam) @ drive[number].T_world_cam
        np.testing.assert_allclose(read[:3, 3], (first @ street.T_world_cam(0.1 * number))[:3, 3], atol=1e-4)
        np.testing.assert_allclose(read[:3, :3], (first @ street.T_world_cam(0.1 * number))[:3, :3], atol=1e-6)


def test_sky_has_no_depth(drive):
    sky, truth = drive[1].sky(), drive[1].truth()
    assert 0 < sky.mean() < 0.6
    assert not truth.valid[sky].any()
    assert truth.density > 0.9 * (1 - sky.mean()) - 0.1


def _projected(frame, xyz_lidar):
    xyz_cam = geometry.transform(frame.T_cam_lidar, xyz_lidar)
    uv_px, depth_m = geometry.project(frame.camera, xyz_cam[xyz_cam[:, 2] > 1])
    return geometry.scatter_nearest(uv_px, depth_m, SIZE)


def _agreement(map_m, truth_m):
    """Share of common pixels within 5 cm of the span of truths around a pixel: a point lies anywhere in its pixel."""
    padded = np.pad(truth_m, 1, mode="edge")
    around = np.stack([padded[i : i + SIZE[0], j : j + SIZE[1]] for i in range(3) for j in range(3)])
    low, high = np.where(around > 0, around, np.inf).min(axis=0) - 0.05, around.max(axis=0) + 0.05
    both = (map_m > 0) & (truth_m > 0)
    return np.mean(((map_m >= low) & (map_m <= high))[both])


def test_untwisted_sweeps_land_on_the_true_depth(drive):
    frame = drive[1]
    truth_m = frame.truth().depth_m
    untwisted = _agreement(_projected(frame, untwist(frame.sweep())), truth_m)
    assert untwisted > 0.93
    assert untwisted > _agreement(_projected(frame, frame.sweep().xyz_m), truth_m)


def test_the_sparse_map_is_the_untwisted_sweep(drive):
    frame = drive[1]
    sparse_m, own_m = frame.sparse().depth_m, _projected(frame, untwist(frame.sweep()))
    both = (sparse_m > 0) & (own_m > 0)
    assert both.sum() > 0.95 * (sparse_m > 0).sum()
    assert np.mean(np.abs(sparse_m - own_m)[both] < 0.02) > 0.95
    assert _agreement(sparse_m, frame.truth().depth_m) > 0.93


def test_the_scanner_sees_past_what_hides_things_from_the_camera(drive):
    frame = drive[0]
    sparse_m, truth_m = frame.sparse().depth_m, frame.truth().depth_m
    behind = (sparse_m > truth_m + 1) & (truth_m > 0)
    assert behind.sum() > 20


def test_a_stopped_run_goes_on_and_ends_with_the_same_bytes(written):
    before = {name: (path.read_bytes(), path.stat().st_mtime_ns) for name, path in _files(written).items()}
    gone = [name for name in before if name.name == "0000000001.bin" or name.match("image_03/data/0000000001.png")]
    assert len(gone) == 3  # the sweep, the picture and its sky mask
    for name in gone:
        (written / name).unlink()
    write_street(written, FRAMES, SEED, SIZE)
    after = _files(written)
    assert set(after) == set(before)
    assert all(path.read_bytes() == before[name][0] for name, path in after.items())
    kept = [name for name in before if name.stem == "0000000002"]
    images = [name for name in kept if name.suffix in (".png", ".bin")]
    assert images
    assert all(after[name].stat().st_mtime_ns == before[name][1] for name in images)


def test_a_finished_drive_is_left_alone(written):
    before = {name: path.stat().st_mtime_ns for name, path in _files(written).items()}
    told = []
    write_street(written, FRAMES, SEED, SIZE, told.append)
    assert told == list(range(FRAMES))
    assert {name: path.stat().st_mtime_ns for name, path in _files(written).items()} == before


def test_another_street_is_not_mixed_in(written):
    with pytest.raises(DataError, match=r"street\.json"):
        write_street(written, FRAMES, SEED, (48, 160))
    note = next(written.rglob("street.json"))
    assert json.loads(note.read_text())["seed"] == SEED


@pytest.mark.parametrize(("frames", "size"), [(0, SIZE), (2, (8, 320))])
def test_unusable_wishes_are_named(tmp_path, frames, size):
    with pytest.raises(DataError, match="at least"):
        write_street(tmp_path, frames, SEED, size)
    assert not any(tmp_path.iterdir())


def test_the_right_camera_is_a_drive_too(written):
    right = open_drive(written, options=DriveOptions(camera="image_03"))
    assert right[0].side == "right"
    assert right[0].truth().density > 0.5
    assert right[0].sky().any()
