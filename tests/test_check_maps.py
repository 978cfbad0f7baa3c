"""The audit of truth and sparse maps: another unit, another frame, numbers that stand for none."""

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import RealData

from priors.check import Finding, check
from priors.drives import DriveOptions, open_drive
from priors.geometry import rays

Map = np.ndarray
FOLDERS = {"truth": "depth", "sparse": "sparse"}


def told(folder: Path, subject: str) -> list[Finding]:
    return [finding for finding in check(open_drive(folder)) if finding.subject == subject]


def wrong(folder: Path, subject: str) -> str:
    return "; ".join(finding.message for finding in told(folder, subject) if finding.level in ("warning", "fatal"))


def rewrite(folder: Path, codes: Callable[[Map], Map]) -> None:
    """Write each PNG anew: `codes` makes its numbers from metres (0 = none)."""
    for path in folder.iterdir():
        metres = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) / 256
        cv2.imwrite(str(path), np.clip(np.rint(codes(metres)), 0, 65535).astype(np.uint16))


SCALES: dict[str, tuple[Callable[[Map], Map], str]] = {
    "millimetres": (lambda m: 1000 * m, "PNG of millimetres"),
    "taken for millimetres": (lambda m: 256 * 0.256 * m, "taken for millimetres"),
    "whole metres": (lambda m: m, "PNG of whole metres"),
    "centimetres": (lambda m: 100 * m, "PNG of centimetres"),
}


@pytest.mark.parametrize("what", FOLDERS)
def test_right_maps_are_silent(street_folder: Path, what: str) -> None:
    assert [finding.level for finding in told(street_folder, what)] == ["ok"]
    shutil.rmtree(street_folder / "right")
    assert not wrong(street_folder, what)
    shutil.rmtree(street_folder / FOLDERS["sparse" if what == "truth" else "truth"])
    assert not wrong(street_folder, what)


@pytest.mark.parametrize(("what", "scale"), [*(("truth", scale) for scale in SCALES), ("sparse", "millimetres")])
def test_stereo_shows_the_unit(street_folder: Path, what: str, scale: str) -> None:
    codes, expected = SCALES[scale]
    rewrite(street_folder / FOLDERS[what], codes)
    findings = told(street_folder, what)
    assert any(finding.level == "fatal" and expected in finding.message for finding in findings)


@pytest.mark.parametrize("scale", ["millimetres", "centimetres"])
def test_without_stereo_the_maps_show_it_and_the_wrong_one_is_told(street_folder: Path, scale: str) -> None:
    shutil.rmtree(street_folder / "right")
    codes, expected = SCALES[scale]
    rewrite(street_folder / "sparse", codes)
    assert expected in wrong(street_folder, "sparse") and not wrong(street_folder, "truth")


@pytest.mark.parametrize("scale", ["millimetres", "whole metres"])
def test_alone_the_ground_shows_it(street_folder: Path, scale: str) -> None:
    for name in ("right", "sparse"):
        shutil.rmtree(street_folder / name)
    codes, expected = SCALES[scale]
    rewrite(street_folder / "depth", codes)
    assert "the ground lies" in wrong(street_folder, "truth") and expected in wrong(street_folder, "truth")
    assert not wrong(street_folder, "poses")  # nothing tells their length
    (street_folder / "poses.txt").unlink()
    assert "the ground lies" in wrong(street_folder, "truth")


def test_float_maps_in_other_units(street_folder: Path) -> None:
    for path in list((street_folder / "depth").iterdir()):
        np.save(path.with_suffix(".npy"), (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) * (1000 / 256)).astype("f4"))
        path.unlink()
    assert "holds millimetres" in wrong(street_folder, "truth")


def test_the_lidar_shows_the_unit(street: Path, tmp_path: Path) -> None:
    shutil.copytree(street, tmp_path / "street")
    for path in tmp_path.glob("street/**/image_03"):
        shutil.rmtree(path)
    assert not wrong(tmp_path / "street", "truth")
    for folder in tmp_path.glob("street/**/groundtruth/image_02"):
        rewrite(folder, lambda m: 1000 * m)
    assert "times that of LiDAR: a PNG of millimetres" in wrong(tmp_path / "street", "truth")


@pytest.mark.parametrize(("what", "number"), [("truth", 65535), ("truth", 80 * 256), ("sparse", 65535), ("sparse", 1)])
def test_numbers_that_stand_for_none_are_told(street_folder: Path, what: str, number: int) -> None:
    rewrite(street_folder / FOLDERS[what], lambda m: np.where(m > 0, m * 256, number))
    (finding,) = [f for f in told(street_folder, what) if f.level != "ok"]
    assert finding.level == "warning" and "stand for none" in finding.message
    assert ("65535" if number == 65535 else f"{number / 256:g} m") in finding.message


@pytest.mark.parametrize(("what", "number"), [("truth", 10 * 256), ("sparse", 80 * 256)])
def test_they_are_told_where_nothing_else_sees_that_place(street_folder: Path, what: str, number: int) -> None:
    for name in {"right", "depth", "sparse"} - {FOLDERS[what]}:
        shutil.rmtree(street_folder / name)
    rewrite(street_folder / FOLDERS[what], lambda m: np.where(m > 0, m * 256, number))
    assert f"exactly {number / 256:g} m: do they stand for none" in wrong(street_folder, what)


@pytest.mark.parametrize("kept", ["right", "sparse"])
def test_distances_along_rays_are_told(street_folder: Path, kept: str) -> None:
    shutil.rmtree(street_folder / ("sparse" if kept == "right" else "right"))
    stretch = np.linalg.norm(rays(open_drive(street_folder)[0].camera), axis=-1)
    rewrite(street_folder / "depth", lambda m: 256 * m * stretch)
    assert "along the rays" in wrong(street_folder, "truth") and not wrong(street_folder, "sparse")


def test_a_fill_value_hides_no_unit(street_folder: Path) -> None:
    rewrite(street_folder / "sparse", lambda m: np.where(m > 0, m * 1000, 65535))
    assert "stand for none" in wrong(street_folder, "sparse") and "PNG of millimetres" in wrong(street_folder, "sparse")


def test_disparities_are_no_depth(street_folder: Path) -> None:
    rewrite(street_folder / "depth", lambda m: np.where(m > 0, 256 * 65 / np.maximum(m, 0.1), 0))
    assert "holds disparities" in wrong(street_folder, "truth")


def test_maps_of_another_frame_are_told(street_folder: Path) -> None:
    paths = sorted((street_folder / "depth").iterdir())
    maps = [cv2.flip(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), 1) for path in paths]
    for path, map_ in zip(paths, maps, strict=True):
        cv2.imwrite(str(path), map_)
    assert wrong(street_folder, "truth")


@pytest.mark.slow
def test_real_maps_in_millimetres(real_data: RealData, tmp_path: Path) -> None:
    shutil.copytree(real_data("kitti_depth"), tmp_path / "depth")
    for folder in tmp_path.glob("depth/**/groundtruth/image_02"):
        rewrite(folder, lambda m: 1000 * m)
    findings = check(open_drive(real_data("kitti_raw"), options=DriveOptions(truth=tmp_path / "depth")))
    by_subject = {finding.subject: finding for finding in findings}
    assert "PNG of millimetres" in by_subject["truth"].message and by_subject["sparse"].level == "ok"
