"""The audit of poses: each way of writing them wrongly names itself, and none is seen in those that are right."""

import os
import shutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from conftest import RealData
from factories import read_pose_rows, write_pose_lines

from priors.check import Finding, check
from priors.drives import DriveOptions, open_drive
from priors.geometry import invert

Pose = np.ndarray
OPENGL = np.diag([1.0, -1, -1, 1])
VEHICLE = np.array([[0.0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1]])
Z_FORWARD = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""Turns a world with z forward and y down into one with x forward and z up, the street's."""
MAPS = ("right", "depth", "sparse")


def told(folder: Path) -> list[Finding]:
    return [finding for finding in check(open_drive(folder)) if finding.subject == "poses"]


def warnings(folder: Path) -> str:
    return "; ".join(finding.message for finding in told(folder) if finding.level in ("warning", "fatal"))


def rewrite(folder: Path, change: Callable[[Pose], Pose]) -> None:
    """Write each pose anew."""
    write_pose_lines(folder / "poses.txt", [change(T) for T in read_pose_rows(folder / "poses.txt")])


def moved(offset_m: tuple[float, float, float], factor: float = 1.0) -> Callable[[Pose], Pose]:
    def change(T: Pose) -> Pose:
        T = T.copy()
        T[:3, 3] = factor * T[:3, 3] + offset_m
        return T

    return change


def transposed(T: Pose) -> Pose:
    return np.block([[T[:3, :3].T, T[:3, 3:]], [T[3:]]])


FAR = moved((455000.3, 5428000.7, 110.0))
RIGHT: dict[str, Callable[[Pose], Pose]] = {
    "as they are": lambda T: T,
    "in a world with z forward": lambda T: invert(Z_FORWARD) @ T,
    "far from the origin": FAR,
}
WRONG: dict[str, tuple[Callable[[Pose], Pose], str]] = {
    "inverted, z up": (invert, "world to camera"),
    "inverted, z forward": (lambda T: invert(invert(Z_FORWARD) @ T), "world to camera"),
    "inverted, far": (lambda T: invert(FAR(T)), "world to camera"),
    "OpenGL": (lambda T: T @ OPENGL, "OpenGL"),
    "the vehicle's": (lambda T: T @ VEHICLE, "x forward, y left, z up"),
    "transposed": (transposed, "rotations transposed"),
    "a twentieth": (moved((0, 0, 0), 0.05), "motion is 1/"),
    "centimetres": (moved((0, 0, 0), 100.0), "centimetres"),
    "millimetres": (moved((0, 0, 0), 1000.0), "millimetres"),
    "float32": (lambda T: FAR(T).astype(np.float32).astype(np.float64), "rounded"),
}


@pytest.mark.parametrize("name", RIGHT)
@pytest.mark.parametrize("alone", [False, True])
def test_right_poses_are_silent(street_folder: Path, name: str, alone: bool) -> None:
    if alone:
        drop(street_folder, *MAPS)
    rewrite(street_folder, RIGHT[name])
    assert {finding.level for finding in told(street_folder)} <= {"ok", "note"}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_poses_name_their_mistake(street_folder: Path, name: str) -> None:
    change, expected = WRONG[name]
    rewrite(street_folder, change)
    assert expected in warnings(street_folder)


@pytest.mark.parametrize("name", ["inverted, z up", "OpenGL", "the vehicle's"])
def test_images_alone_show_which_way_the_camera_moves(street_folder: Path, name: str) -> None:
    drop(street_folder, *MAPS)
    change, expected = WRONG[name]
    rewrite(street_folder, change)
    assert expected in warnings(street_folder)


@pytest.mark.parametrize(("kept", "by"), [("depth", "truth"), ("sparse", "sparse")])
def test_maps_show_how_far_it_moves(street_folder: Path, kept: str, by: str) -> None:
    drop(street_folder, *(name for name in MAPS if name != kept))
    assert not warnings(street_folder)
    rewrite(street_folder, moved((0, 0, 0), 0.05))
    assert f"of what {by} sees" in warnings(street_folder)


def test_the_lidar_shows_how_far_it_moves(street: Path, tmp_path: Path) -> None:
    shutil.copytree(street, tmp_path / "street")
    for path in tmp_path.glob("street/**/image_03"):
        shutil.rmtree(path)
    for path in tmp_path.glob("street/**/oxts/data/*.txt"):  # half as far along the street
        latitude, longitude, rest = path.read_text().split(" ", 2)
        path.write_text(f"{0.3 * float(latitude)} {0.3 * float(longitude)} {rest}")
    assert "of what LiDAR sees" in warnings(tmp_path / "street")


def test_steps_instead_of_poses_are_named(street_folder: Path) -> None:
    poses = read_pose_rows(street_folder / "poses.txt")
    steps = [invert(before) @ after for before, after in pairwise(poses)]
    write_pose_lines(street_folder / "poses.txt", [np.eye(4), *steps])
    assert "chain them" in warnings(street_folder)


def test_poses_that_stand_still_are_not_called_turned(street_folder: Path) -> None:
    rewrite(street_folder, lambda T: np.eye(4))
    assert "the poses stand still, and stereo sees the camera move" in warnings(street_folder)


@pytest.mark.slow
def test_turns_tell_inverted_poses_in_a_world_that_looks_back(real_data: RealData, tmp_path: Path) -> None:
    """Where z of the world points backwards, inverted poses move a car in the right direction, and turn it wrongly."""
    shutil.copytree(real_data("kitti_odometry") / "sequences/01", tmp_path / "sequences/01", copy_function=os.symlink)
    (tmp_path / "poses").mkdir()
    world = [OPENGL @ T for T in read_pose_rows(real_data("kitti_odometry") / "poses/01.txt")]
    for poses, expected in ((world, 0), ([invert(T) for T in world], 1)):
        write_pose_lines(tmp_path / "poses/01.txt", poses)
        findings = check(open_drive(tmp_path, options=DriveOptions(drive="01")))
        told = [finding.message for finding in findings if finding.subject == "poses" and finding.level == "warning"]
        assert len(told) == expected and all("inverted (world to camera)" in message for message in told)


def test_without_evidence_a_camera_that_moves_down_is_told(image_folder: Path) -> None:
    """The folder's images are noise: only the poses can tell."""
    assert not warnings(image_folder)
    rewrite(image_folder, lambda T: T @ VEHICLE)
    assert "sideways" in warnings(image_folder)
    looking_down = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    rewrite(image_folder, lambda T: T @ invert(VEHICLE) @ looking_down)
    assert "none of its own axes" in warnings(image_folder)


def test_a_jump_is_told_and_the_rest_is_compared(street_folder: Path) -> None:
    poses = read_pose_rows(street_folder / "poses.txt")
    write_pose_lines(street_folder / "poses.txt", [*poses[:3], *(moved((5, 3, 0))(T) for T in poses[3:])])
    assert "1 jumps" in warnings(street_folder) and "axes" not in warnings(street_folder)


def drop(folder: Path, *names: str) -> None:
    for name in names:
        shutil.rmtree(folder / name)
