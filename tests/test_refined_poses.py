"""Refined poses: made once, kept beside the cache, taken by --poses refined, and told with every score."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from cli.priors import PROGRAM
from nerf.split import held_out, split
from priors import build, refined_poses
from priors.drives import DriveOptions, RefinedDrive, open_drive, poses_remark, reopen
from priors.egomotion.make import make
from priors.egomotion.sight import Eyes
from priors.errors import DataError, UsageError
from priors.geometry import invert
from priors.methods.lidar import Lidar
from priors.pairs.rectification import RectificationError
from priors.refined_poses import Recipe, RefinedPoses
from priors.types import Drive

BY_PAIR = Eyes("stereo", RectificationError())


def refined(cache: Path) -> DriveOptions:
    return DriveOptions(poses="refined", poses_from=cache)


def shift(drive: Drive, cache: Path, metres: float = 0.25, left_out: tuple[str, ...] = ()) -> RefinedPoses:
    """Write 'refined' poses: the drive's own, each moved along its own x axis by as much more as it is later."""
    frames = [drive[index] for index in range(len(drive))]
    recipe = Recipe(drive.describe(), drive.fingerprint(), [frame.id for frame in frames], left_out, "stereo")
    poses = []
    for number, frame in enumerate(frames):
        T = frame.pose().copy()
        T[:3, 3] += metres * number * T[:3, 0]
        poses.append(T)
    folder = recipe.folder(cache / drive.name)
    refined_poses.write(folder, recipe, poses, {})
    return refined_poses.load(folder)


def test_frames_and_sweeps_move_and_the_drive_is_another(street: Path, tmp_path: Path) -> None:
    own = open_drive(street)
    shift(own, tmp_path)
    drive = open_drive(street, options=refined(tmp_path))
    assert isinstance(drive, RefinedDrive)
    assert (drive.name, list(drive.ids), len(drive)) == (own.name, list(own.ids), len(own))
    assert drive.fingerprint() != own.fingerprint()
    for index, offset in ((0, 0), (2, 1), (5, -3), (0, 5)):
        moved = drive[index].pose()[:3, 3] - own[index].pose()[:3, 3]
        np.testing.assert_allclose(moved, 0.25 * index * own[index].pose()[:3, 0], atol=1e-9)
        sweep, before = drive[index].sweep(offset), own[index].sweep(offset)
        T_cam_lidar = drive[index].T_cam_lidar
        assert sweep is not None and before is not None and T_cam_lidar is not None
        np.testing.assert_array_equal(sweep.xyz_m, before.xyz_m)
        np.testing.assert_allclose(sweep.T_world_lidar, drive[index + offset].pose() @ T_cam_lidar, atol=1e-6)
    np.testing.assert_array_equal(drive[1].image(), own[1].image())


def test_a_manifest_reopens_them_and_other_poses_are_others(street: Path, tmp_path: Path) -> None:
    own = open_drive(street)
    poses = shift(own, tmp_path)
    drive = open_drive(street, options=refined(tmp_path))
    again = reopen(drive.describe())
    assert again.fingerprint() == drive.fingerprint() and again.describe() == drive.describe()
    assert build.prepare(drive, Lidar(), folder=tmp_path).prior.folder != build.prepare(own, Lidar()).prior.folder
    shutil.rmtree(poses.folder)
    with pytest.raises(DataError, match=r"poses\.json: no such file: `priors poses DATA` makes refined poses"):
        reopen(drive.describe())
    shift(own, tmp_path, 0.5)
    assert open_drive(street, options=refined(tmp_path)).fingerprint() != drive.fingerprint()


def test_which_poses_are_taken(street: Path, street_folder: Path, tmp_path: Path) -> None:
    own, cache = open_drive(street), tmp_path / "cache"
    with pytest.raises(DataError, match="no refined poses of this drive: make them by `priors poses`"):
        open_drive(street, options=refined(cache))
    one, two = shift(own, cache), shift(own, cache, left_out=(own.ids[3],))
    assert one.folder != two.folder
    with pytest.raises(DataError, match="several refined poses of this drive: name one by --poses-from: "):
        open_drive(street, options=refined(cache))
    assert isinstance(open_drive(street, options=refined(two.folder)), RefinedDrive)
    with pytest.raises(DataError, match=r"poses of .*, not of this own: run `priors poses` on it"):
        open_drive(street_folder, options=refined(one.folder))


def test_scores_tell_whose_images_took_part(street: Path, tmp_path: Path) -> None:
    own = open_drive(street)
    shift(own, tmp_path, left_out=(own.ids[1],))
    drive = open_drive(street, options=refined(tmp_path))
    assert poses_remark(own, own.ids) == ()
    for held, told in ((own.ids[1:2], "none of the 1"), (own.ids[1:4], "2 of the 3")):
        assert poses_remark(drive, held) == (f"poses refined by stereo: {told} held-out views took part in it",)


@pytest.mark.parametrize("spoil", ["record", "format", "poses", "short"])
def test_damaged_poses_are_told_in_a_line(street: Path, tmp_path: Path, spoil: str) -> None:
    folder = shift(open_drive(street), tmp_path).folder
    record, poses = folder / "poses.json", folder / "poses.txt"
    if spoil == "record":
        record.write_text("{", encoding="utf-8")
    elif spoil == "format":
        record.write_text(json.dumps({"format": 99}), encoding="utf-8")
    else:
        poses.write_text("" if spoil == "poses" else "0000000000 1 2 3\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"poses\.(json|txt): .*run `priors poses` again"):
        refined_poses.load(folder)


def test_a_frame_without_a_refined_pose_says_so(street: Path, tmp_path: Path) -> None:
    folder = shift(open_drive(street), tmp_path).folder
    lines = (folder / "poses.txt").read_text(encoding="utf-8").splitlines(keepends=True)
    (folder / "poses.txt").write_text("".join(lines[:3]), encoding="utf-8")
    drive = open_drive(street, options=refined(tmp_path))
    with pytest.raises(DataError, match="no refined pose of this frame"):
        drive[4].pose()
    sweep = drive[2].sweep(2)
    assert sweep is not None and sweep.T_world_lidar is None


def test_they_are_made_once(street: Path, tmp_path: Path) -> None:
    drive, steps = open_drive(street), []
    first = make(drive, BY_PAIR, cache=tmp_path, on_frame=lambda: steps.append(1))
    again = make(drive, BY_PAIR, cache=tmp_path, on_frame=lambda: steps.append(1))
    assert len(steps) == len(drive)
    assert again.digest == first.digest and again.folder == first.folder
    for id_, frame in zip(drive.ids, (drive[index] for index in range(6)), strict=True):
        off = invert(frame.pose()) @ first.T_world_cam[id_]
        assert np.linalg.norm(off[:3, 3]) < 0.2, "the street's own poses are right"
    with pytest.raises(DataError, match="its poses are refined already"):
        make(open_drive(street, options=refined(tmp_path)), BY_PAIR, cache=tmp_path)


def test_the_command(street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert PROGRAM.run(["poses", str(street), "--frames", "0:6", "--cache", str(tmp_path), "--source", "stereo"]) == 0
    told = capsys.readouterr().out
    assert "6 poses by stereo" in told and "all frames took part" in told and "px sideways" in told
    drive = open_drive(street, options=refined(tmp_path))
    assert PROGRAM.run(["build", str(street), "--method", "lidar", "--dry-run", "--poses", "refined",
                        "--poses-from", str(tmp_path), "--cache", str(tmp_path)]) == 0  # fmt: skip
    assert build.prepare(drive, Lidar(), folder=tmp_path).prior.folder.name in capsys.readouterr().out.replace("\n", "")
    assert PROGRAM.run(["poses", str(street), "--poses", "refined"]) == 2
    assert "these are made here" in capsys.readouterr().err


def test_held_out_is_what_a_fit_holds_out() -> None:
    for count in (1, 9, 10, 25):
        assert held_out(count) == split(count, "dense")[1] == split(count, "1")[1]


def test_poses_from_alone_is_no_choice() -> None:
    with pytest.raises(UsageError, match="--poses-from elsewhere: expected --poses refined beside it"):
        DriveOptions(poses_from=Path("elsewhere"))
