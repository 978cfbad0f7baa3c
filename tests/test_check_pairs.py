"""The audit of pairs: those that cannot work are told, and what stereo then sees is no evidence against the rest."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from priors.check import Finding, check
from priors.drives import open_drive


def audit(folder: Path) -> dict[str, list[Finding]]:
    """The findings that are worse than a note, by subject."""
    found: dict[str, list[Finding]] = {}
    for finding in check(open_drive(folder)):
        if finding.level in ("warning", "fatal"):
            found.setdefault(finding.subject, []).append(finding)
    return found


def repaint(folder: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    for path in folder.iterdir():
        cv2.imwrite(str(path), change(cv2.imread(str(path))))


def swap(folder: Path) -> None:
    (folder / "left").rename(folder / "was left")
    (folder / "right").rename(folder / "left")
    (folder / "was left").rename(folder / "right")


def same_twice(folder: Path) -> None:
    shutil.rmtree(folder / "right")
    shutil.copytree(folder / "left", folder / "right")


def another_moment(folder: Path) -> None:
    """Give each right image the next frame's pixels."""
    paths = sorted((folder / "right").iterdir())
    images = [path.read_bytes() for path in paths]
    for path, image in zip(paths, [*images[1:], images[0]], strict=True):
        path.write_bytes(image)


@pytest.mark.parametrize(
    ("fault", "expected"),
    [(swap, "swap left and right"), (same_twice, "the same images"), (another_moment, "one frame ahead")],
)
def test_a_pair_that_cannot_work_is_fatal_and_nothing_else_is_blamed(
    street_folder: Path, fault: Callable[[Path], None], expected: str
) -> None:
    assert not audit(street_folder)
    fault(street_folder)
    found = audit(street_folder)
    assert [f.level for f in found["stereo"]] == ["fatal"] and expected in found["stereo"][0].message
    assert fault is swap or set(found) == {"stereo"}  # swapped, the maps are the other camera's


def test_one_grey_image_is_noted_and_matched(street_folder: Path) -> None:
    repaint(street_folder / "left", lambda image: cv2.cvtColor(image, cv2.COLOR_BGR2GRAY))
    findings = check(open_drive(street_folder))
    assert ("note", "the two images are grey and in colour: they are matched in grey") in [
        (f.level, f.message) for f in findings if f.subject == "stereo"
    ]
    assert not audit(street_folder)


def test_sizes_that_differ_are_fatal(street_folder: Path) -> None:
    repaint(street_folder / "right", lambda image: cv2.resize(image, None, fx=0.5, fy=0.5))
    assert "resized" in audit(street_folder)["files"][0].message


@pytest.mark.parametrize("side", ["left", "right"])
def test_blank_images_are_told(street_folder: Path, side: str) -> None:
    repaint(street_folder / side, np.zeros_like)
    assert set(audit(street_folder)) == {"stereo"}  # what is matched there speaks against no map


def test_a_single_frame_whose_images_are_one_is_told(street_folder: Path) -> None:
    left, right = (sorted((street_folder / side).iterdir())[2] for side in ("left", "right"))
    shutil.copy(left, right)
    (finding,) = audit(street_folder)["stereo"]
    assert finding.level == "fatal" and left.stem in finding.message and "the same image" in finding.message


def test_an_unusual_baseline_is_blamed_not_the_maps(street_folder: Path) -> None:
    path = street_folder / "calib.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "baseline_m": 54.0}))
    found = audit(street_folder)
    assert "is it metres?" in found["calibration"][0].message
    assert "are baseline and focal length right?" in found["truth"][0].message


def test_another_focal_length_is_blamed_not_the_maps(street_folder: Path) -> None:
    path = street_folder / "calib.json"
    calib = json.loads(path.read_text())
    path.write_text(json.dumps({**calib, "fx": 2 * calib["fx"], "fy": 2 * calib["fy"]}))
    found = audit(street_folder)
    for what in ("truth", "sparse"):
        assert ["are baseline and focal length right?" in finding.message for finding in found[what]] == [True]
    assert "poses" not in found
