"""A street whose calibration is wrong: the check tells it, and `--lidar.extrinsics measured` makes it good."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cli.priors import PROGRAM
from priors.cache import find
from priors.check import check
from priors.drives import open_drive
from priors.extrinsics.correction import Correction
from priors.extrinsics.measure import measure
from priors.score import score
from priors.street.write import Asked, write_drive
from priors.types import Drive, Frame

pytestmark = pytest.mark.slow
FRAMES, SIZE = 8, (188, 621)
TURN_DEG = 0.3


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight frames at half of KITTI's size."""
    return write_drive(tmp_path_factory.mktemp("turned"), Asked(FRAMES, 7, SIZE), workers=2)


def frames_of(drive: Drive, wrong: Correction) -> list[Frame]:
    return [wrong.frame(drive[index]) for index in range(len(drive))]


def test_a_street_as_it_is(street: Path) -> None:
    measured = measure(frames_of(open_drive(street), Correction()))
    assert measured.correction.size_deg < 0.05 and not measured.has_delay
    assert all(error < 0.1 for error in measured.errors_deg)
    levels = {finding.level for finding in check(open_drive(street)) if "against the camera" in finding.message}
    assert levels == {"ok"}


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_turn_is_found(street: Path, axis: int) -> None:
    turn = (TURN_DEG * np.eye(3)[axis]).tolist()
    measured = measure(frames_of(open_drive(street), Correction((turn[0], turn[1], turn[2]))))
    np.testing.assert_allclose(measured.correction.turn_deg, -np.array(turn), atol=0.05)


def test_a_delay_is_found(street: Path) -> None:
    measured = measure(frames_of(open_drive(street), Correction(delay_s=-0.02)))
    assert abs(measured.correction.delay_s - 0.02) < 0.006 and measured.correction.size_deg < 0.08


def test_without_the_second_camera_yaw_is_told_alone(street: Path) -> None:
    drive = open_drive(street)
    mono = []
    for frame in frames_of(drive, Correction((0.0, TURN_DEG, 0.0))):
        readers = {what: read for what, read in frame.readers.items() if what != "other"}
        mono.append(Frame(frame.id, frame.camera, readers, T_cam_lidar=frame.T_cam_lidar))
    measured = measure(mono)
    assert abs(measured.correction.turn_deg[1] + TURN_DEG) < 0.06
    assert str(measured).startswith("turned by") and "pitch not seen" in str(measured)


def test_what_is_measured_mends_a_turned_calibration(street: Path, tmp_path: Path) -> None:
    """The files are changed, and given back: others read the street too."""
    calibration = street.parent / "calib_velo_to_cam.txt"
    before = calibration.read_text()
    errors = {"right": absrel(street, tmp_path / "right", "calibration")}
    try:
        calibration.write_text(turned(before))
        told = [f for f in check(open_drive(street)) if "against the camera" in f.message]
        assert [f.level for f in told] == ["warning"] and "--lidar.extrinsics measured" in told[0].message
        errors |= {how: absrel(street, tmp_path / how, how) for how in ("calibration", "measured")}
    finally:
        calibration.write_text(before)
    assert errors["calibration"] > 2 * errors["right"]
    assert errors["measured"] < 1.1 * errors["right"] + 0.0003


def turned(text: str) -> str:
    lines = []
    for line in text.splitlines():
        if line.startswith("R:"):
            R = np.array([float(word) for word in line.split()[1:]]).reshape(3, 3)
            turn = Rotation.from_rotvec([TURN_DEG, -TURN_DEG, TURN_DEG], degrees=True).as_matrix()
            line = "R: " + " ".join(repr(float(value)) for value in (turn @ R).ravel())
        lines.append(line)
    return "\n".join(lines) + "\n"


def absrel(street: Path, cache: Path, extrinsics: str) -> float:
    words = ["--method", "lidar", "--lidar.extrinsics", extrinsics, "--cache", str(cache)]
    assert PROGRAM.run(["build", str(street), *words]) == 0
    (prior,) = find(cache)
    return score(prior).result.metrics()["abs_rel"]
