"""What training leaves out: blocks of real frames with truth, by one table; nothing of them leaks into what trains."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import RealData
from factories import write_raw
from layouts.kitti_stereo import write_2015
from test_learn_data import write_street

from cli.priors import PROGRAM
from priors.drives import open_drive
from priors.errors import DataError
from priors.geometry import convert_disparity
from priors.held_back import BLOCKS, held_back, is_held_back, training_frames
from priors.learn import pair_file
from priors.learn.real_truth import DRIVE, KITTI2015, RealTruth, as_matched, label, label_frames
from priors.learn.stereo_data import SHARES, SHARES_WITH_TRUTH, Folders, Sources, find_sources, mixture, validation
from priors.pairs.rectification import RectificationError
from priors.types import Camera

pytestmark = pytest.mark.networks


@pytest.mark.parametrize(
    ("drive", "held", "trained"),
    [
        ("kitti_stereo2015_training", ["000022_10", "000041_10", "000128_10"], ["000010_10", "000021_10", "000026_10"]),
        ("2011_09_26_drive_0009_sync", ["0000000026", "50"], ["0000000000", "25", "51"]),
        ("2011_09_26_drive_0009_sync-image_03", ["0000000026"], ["0000000025"]),
        ("2011_09_26_drive_0009_extract", ["0000000026"], ["0000000025"]),
        ("2011_09_26_drive_0001_sync", ["0000000000", "0000000107"], []),
        ("2011_09_26_drive_00091_sync", [], ["0000000026"]),
        ("kitti_stereo2012_training", [], ["000022_10"]),
        ("street", [], ["a", "0000000030"]),
    ],
)
def test_blocks_by_the_name_of_a_drive(drive: str, held: list[str], trained: list[str]) -> None:
    assert all(is_held_back(drive, id_) for id_ in held)
    assert not any(is_held_back(drive, id_) for id_ in trained)


def test_a_fifth_of_kitti_2015_is_held_back_in_blocks() -> None:
    blocks = BLOCKS["kitti_stereo2015_training"]
    assert sum(last - first + 1 for first, last in blocks) == 16
    assert all(last - first == 3 for first, last in blocks)


def test_each_frame_is_either_held_back_or_trains(tmp_path: Path) -> None:
    drive = open_drive(write_raw(tmp_path, range(23, 29)))
    held = [drive.ids[index] for index in held_back(drive)]
    trains = training_frames(drive)
    assert held == ["0000000026", "0000000027", "0000000028"]
    assert [frame.id for frame in trains] == ["0000000023", "0000000024", "0000000025"]
    last = trains[-1]
    assert last.sweep() is not None and last.sweep(-1) is not None
    assert last.sweep(1) is None and drive[2].sweep(1) is not None  # its accumulated truth holds nothing of the others
    with pytest.raises(DataError, match=r"no frame of it is held back .*kitti_stereo2015_training"):
        held_back(open_drive(write_raw(tmp_path / "other", range(3), "2011_09_28_drive_0002_sync")))


def test_bench_takes_held_back_frames_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(write_raw(tmp_path, range(23, 29)))
    bench = ["bench", folder, "--held-back", "--times-only", "--only", "SGBM half", "--cache", str(tmp_path / "cache")]
    assert PROGRAM.run(bench) == 0
    assert "drive_0009_sync, 3 frames" in capsys.readouterr().out
    assert PROGRAM.run([*bench, "--frames", "23:25"]) == 2
    assert "--frames 23:25: none of these frames is held back" in capsys.readouterr().err
    assert PROGRAM.run([*bench, "--frames", "25:28", "--count", "1"]) == 0
    assert "1 frame of" in capsys.readouterr().out


def test_truth_as_the_images_have_it_is_the_inverse_of_the_correction() -> None:
    camera = Camera(np.array([[700.0, 0, 60], [0, 700, 40], [0, 0, 1]]), (80, 120))
    error = RectificationError(0.5, 0.3, 1.1, -0.7, 0.981)
    matched_px = np.random.default_rng(0).uniform(2, 90, camera.size).astype(np.float32)
    true_px = error.correct(matched_px, camera)
    np.testing.assert_allclose(as_matched(true_px, error, camera), matched_px, atol=1e-4)
    true_px[::2] = 0
    assert not as_matched(true_px, error, camera)[::2].any()


def test_a_label_is_the_truth_less_the_rectification_error(tmp_path: Path) -> None:
    """The factory's pair is exact: its right view is the left one, shifted by whole pixels; we misplace its truth."""
    split = write_2015(tmp_path)
    drive = open_drive(split)
    frame = drive[0]
    assert frame.baseline_m is not None
    true_px = convert_disparity(frame.truth().depth_m, frame.camera.fx, frame.baseline_m)
    error = RectificationError(0.7, 0.0, 0.0, 0.0, 1.0)
    moved = convert_disparity(error.correct(true_px, frame.camera), frame.camera.fx, frame.baseline_m)
    readers = {**frame.readers, "truth": lambda: type(frame.truth())(moved)}
    pair = label(replace(frame, readers=readers), KITTI2015)
    whole_px = np.floor(true_px)  # the truth's fractions count columns
    known = pair.weight == 1
    assert known.mean() > 0.9
    assert np.abs(pair.disparity_px - whole_px)[known].mean() < 0.35  # 0.7 px were taken off, and the mean fraction


def test_shares_cover_what_there_is() -> None:
    for shares in (SHARES, SHARES_WITH_TRUTH):
        assert sum(shares.values()) == pytest.approx(1)
    path = [Path("x")]
    assert set(Sources(path, path, path, path, path, path).drawn()) == set(SHARES_WITH_TRUTH)
    assert set(Sources(path, (), path).drawn()) == {"street", "warped"}


def test_pairs_with_truth_are_drawn_and_those_held_back_validate(tmp_path: Path) -> None:
    split = write_2015(tmp_path / "data" / "kitti_stereo2015")
    folders = Folders(write_street(tmp_path), real=tmp_path / "data")
    train, held = find_sources(folders)
    assert [path.stem for path in train.kitti2015] == ["kitti2015_000000_10", "kitti2015_000001_10"]
    assert not held.kitti2015 and not train.drive0009 and not train.odometry
    for path in sorted(split.rglob("000001*")):
        path.rename(path.with_name(path.name.replace("000001", "000125")))
    train, held = find_sources(folders)
    assert [path.stem for path in train.kitti2015] == ["kitti2015_000000_10"]
    assert [path.stem for path in held.kitti2015] == ["kitti2015_000125_10"]
    draw = mixture(folders, (48, 96))
    drawn = {draw(np.random.default_rng([0, step])).source for step in range(30)}
    assert drawn == {"street", KITTI2015}
    assert KITTI2015 in {pair.source for pair in validation(folders, count=2)}


def test_real_frames(real_data: RealData, tmp_path: Path) -> None:
    """65 of 81 pairs and 26 of 51 frames train; a sweep beside a pair fits its truth."""
    folder = real_data("kitti_stereo2015").parent
    truth = RealTruth(folder)
    frames = truth.frames
    assert len(frames[KITTI2015]) == 65 and len(truth.held_back) == 16
    assert not {frame.id for frame in frames[KITTI2015]} & {frame.id for frame in truth.held_back}
    if DRIVE in frames:
        assert len(frames[DRIVE]) == 26 and frames[DRIVE][25].sweep(1) is None
    pair = label(frames[KITTI2015][0], KITTI2015)
    assert 0.15 < (pair.weight == 1).mean() < 0.6 and pair.disparity_px.max() < 192
    path = tmp_path / "pair.npz"
    pair_file.write(path, pair)
    assert np.abs(pair_file.read(path).disparity_px - pair.disparity_px).max() <= 1 / 512
    assert label_frames(tmp_path, tmp_path / "none") == {}
