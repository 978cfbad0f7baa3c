"""KITTI submissions: archives as the devkits read them, and what a server would refuse."""

import zipfile
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from exported import truth_prior
from factories import write_folder, write_raw
from PIL import Image

from priors.cache import Prior
from priors.drive_around import DriveAround
from priors.drives import open_drive
from priors.errors import DataError
from priors.export import kitti, place
from priors.export.views import Views, choose
from priors.filters import Filters
from priors.geometry import convert_disparity
from priors.types import Depth, Drive, Frame

pytestmark = pytest.mark.datasets


def all_views(prior: Prior, drive: Drive, frames: str | None = None) -> Views:
    return choose(prior, drive, frames, Filters(), posed=False)


def members(path: Path) -> dict[str, np.ndarray]:
    """Unpack an archive's maps as PIL reads them: codes (height, width)."""
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        found = {}
        for name in archive.namelist():
            with archive.open(name) as file, Image.open(file) as image:
                assert image.format == "PNG" and image.mode in ("I;16", "I")
                found[name] = np.array(image).astype(np.int64)
        return found


@pytest.fixture
def pairs(tmp_path: Path) -> Drive:
    """Three frames called as those of stereo 2015."""
    return open_drive(write_folder(tmp_path / "mine", ["000000_10", "000001_10", "000002_10"]))


def test_disparities_are_those_of_the_prior(pairs: Drive, tmp_path: Path) -> None:
    prior, out = truth_prior(pairs, tmp_path / "cache"), tmp_path / "mine.zip"
    depth = prior.read("000001_10")
    depth.depth_m[0, :3] = 0, 250, 0.3  # no value, the least disparity, and one that 16 bits cannot hold
    prior.write("000001_10", depth, 0.1)
    lines = kitti.write(out, all_views(prior, pairs), kitti.benchmark_of(all_views(prior, pairs)))
    found = members(out)
    assert list(found) == [f"disp_0/00000{n}_10.png" for n in range(3)]
    for id_, codes in zip(pairs.ids, found.values(), strict=True):
        depth_m = prior.read(id_).depth_m
        wanted_px = convert_disparity(depth_m, pairs[0].camera.fx, pairs[0].baseline_m or 0)
        held = wanted_px < 255.99
        assert np.abs(codes[held] / 256 - wanted_px[held]).max() <= 1 / 512 + 1e-6
        assert np.array_equal(codes > 0, (depth_m > 0) & held)
    assert found["disp_0/000001_10.png"][0, :3].tolist() == [0, round(100 / 250 * 256), 0]
    assert "1 values are larger than 255.99" in lines[1]
    assert lines[2:] == ["KITTI's server refuses it: 197 of 200 test images are missing"]


def test_a_disparity_near_zero_stays_a_value(pairs: Drive, tmp_path: Path) -> None:
    class Short(DriveAround):
        def __getitem__(self, index: int) -> Frame:
            return replace(self.drive[index], baseline_m=0.001)

    prior = truth_prior(pairs, tmp_path / "cache")
    prior.write("000000_10", Depth(np.full((96, 240), 200, np.float32)), 0.1)
    kitti.write(tmp_path / "mine.zip", all_views(prior, Short(pairs)), "stereo2015")
    assert (members(tmp_path / "mine.zip")["disp_0/000000_10.png"] == 1).all()


def test_depth_is_what_the_cache_holds(tmp_path: Path) -> None:
    root = write_folder(tmp_path / "mine", [f"{n:010d}" for n in range(2)])
    drive = open_drive(root)
    prior, out = truth_prior(drive, tmp_path / "cache"), tmp_path / "new" / "mine.zip"
    views = all_views(prior, drive)
    assert kitti.benchmark_of(views) == "completion"
    lines = kitti.write(out, views, "completion")
    for name, codes in members(out).items():
        assert np.array_equal(codes, cv2.imread(str(prior.depth_path(name[:-4])), cv2.IMREAD_UNCHANGED))
    refused = [line.removeprefix("KITTI's server refuses it: ") for line in lines[1:]]
    assert refused == [
        "998 of 1000 test images are missing",
        "0000000000.png: is 240x96, not 1216x352",
        "0000000001.png: is 240x96, not 1216x352",
    ]
    with zipfile.ZipFile(out) as archive:
        assert b"metres x 256" in archive.comment
    place.expect_ours(out)
    first = out.read_bytes()
    kitti.write(out, views, "completion")
    assert out.read_bytes() == first


def test_a_whole_archive_is_taken(tmp_path: Path) -> None:
    data = cv2.imencode(".png", np.full((4, 5), 256, np.uint16))[1].tobytes()
    with zipfile.ZipFile(tmp_path / "mine.zip", "w") as archive:
        for number in range(200):
            archive.writestr(f"disp_0/{number:06d}_10.png", data)
    assert kitti.check(tmp_path / "mine.zip", "stereo2015") == []


@pytest.mark.parametrize(
    ("name", "codes", "says"),
    [
        ("disp_0/000000_11.png", np.ones((4, 5), np.uint16), "no test image is called so"),
        ("000000_10.png", np.ones((4, 5), np.uint16), "no test image is called so"),
        ("disp_0/000000_10.png", np.ones((4, 5), np.uint8), "no 16-bit PNG"),
        ("disp_0/000000_10.png", np.ones((4, 5, 3), np.uint16), "no 16-bit PNG"),
        ("disp_0/000000_10.png", np.zeros((4, 5), np.uint16), "has no value"),
    ],
)
def test_what_a_server_refuses_is_told(tmp_path: Path, name: str, codes: np.ndarray, says: str) -> None:
    with zipfile.ZipFile(tmp_path / "mine.zip", "w") as archive:
        archive.writestr(name, cv2.imencode(".png", codes)[1].tobytes())
    assert says in kitti.check(tmp_path / "mine.zip", "stereo2015")[1]


@pytest.mark.parametrize(
    ("ids", "camera", "method", "benchmark"),
    [
        (["0000000000", "0000000001"], "image_02", "stereo", "completion"),
        (["0000000000", "0000000001"], "image_02", "mono", "prediction"),
        (["000000_10", "000001_10"], "image_2", "stereo", "stereo2015"),
        (["000000_10", "000001_10"], "image_0", "stereo", "stereo2012"),
        (["000000", "000001"], "colored_0", "mono", "stereo2012"),
    ],
)
def test_the_benchmark_is_told_by_names_camera_and_method(
    tmp_path: Path, ids: list[str], camera: str, method: str, benchmark: str
) -> None:
    class Named(DriveAround):
        def describe(self) -> dict:
            return {**self.drive.describe(), "camera": camera}

    own = open_drive(write_folder(tmp_path / "mine", ids))
    prior = truth_prior(own, tmp_path / "cache")
    prior.manifest["method"] = method
    assert kitti.benchmark_of(all_views(prior, Named(own))) == benchmark


def test_stereo_2012_lies_in_the_root(pairs: Drive, tmp_path: Path) -> None:
    views = all_views(truth_prior(pairs, tmp_path / "cache"), pairs)
    lines = kitti.write(tmp_path / "2012.zip", views, "stereo2012")
    kitti.write(tmp_path / "2015.zip", views, "stereo2015")
    older, newer = members(tmp_path / "2012.zip"), members(tmp_path / "2015.zip")
    assert list(older) == [f"00000{n}_10.png" for n in range(3)]
    assert all(np.array_equal(codes, newer[f"disp_0/{name}"]) for name, codes in older.items())
    assert lines[1:] == ["KITTI's server refuses it: 192 of 195 test images are missing"]


def test_other_frames_are_no_submission(tmp_path: Path) -> None:
    own = open_drive(write_folder(tmp_path / "mine"))
    prior = truth_prior(own, tmp_path / "cache")
    with pytest.raises(DataError, match="frame a: KITTI's test images are called 0000000000"):
        kitti.benchmark_of(all_views(prior, own))
    with pytest.raises(DataError, match=r"called like 000000_10\.png"):
        kitti.write(tmp_path / "mine.zip", all_views(prior, own), "stereo2015")
    assert not list(tmp_path.glob("*.zip")) and not list(tmp_path.glob(".*"))


def test_disparities_are_the_left_eyes(tmp_path: Path) -> None:
    write_raw(tmp_path / "raw", range(2))
    drive = open_drive(tmp_path / "raw" / "2011_09_26" / "2011_09_26_drive_0009_sync")

    class Right(DriveAround):
        def __getitem__(self, index: int) -> Frame:
            return replace(self.drive[index], id=f"{index:06d}", side="right")

        @property
        def ids(self) -> list[str]:
            return ["000000", "000001"]

    right = Right(drive)
    prior = truth_prior(open_drive(write_folder(tmp_path / "m", right.ids)), tmp_path / "cache")
    with pytest.raises(DataError, match="a pair's left camera"):
        kitti.write(tmp_path / "mine.zip", all_views(prior, right), "stereo2015")
