"""Published sequences by name: found in folders as people have them, whole or refused in one line."""

import shutil
from pathlib import Path
from typing import get_args, get_type_hints

import pytest
from factories import write_argoverse_tracking, write_odometry, write_raw

from cli.arguments import SequenceArguments
from cli.nerf import PROGRAM as NERF
from cli.nerf.study import StudyArguments
from cli.priors import PROGRAM as PRIORS
from nerf.rate import Rate
from nerf.run import open_run
from priors.drives import DriveOptions, open_drive
from priors.errors import DataError, UsageError
from priors.sequences import SEQUENCES, Sequence, expect_whole, find

LOG = "2c07fcda-6671-3ac0-ac23-4a232e0e031e"
KITTI = [f"study-{number}" for number in range(1, 6)]


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> Sequence:
    """study-1 with the four frames 2 to 5 of its drive, which the tiny drives have."""
    made = Sequence(SEQUENCES["study-1"].drives, SEQUENCES["study-1"].cameras, (2, 5), 10.0, "KITTI's drive")
    monkeypatch.setattr("priors.sequences.SEQUENCES", {**SEQUENCES, "study-1": made})
    return made


def raw(root: Path) -> Path:
    return write_raw(root, name="2011_10_03_drive_0027_sync")


def test_the_table_is_the_study_s() -> None:
    counts = [SEQUENCES[name].frames for name in KITTI]
    assert [last + 1 - first for first, last in filter(None, counts)] == [131, 139, 301, 181, 326]
    assert [sequence.range for sequence in SEQUENCES.values()] == [
        "657:788", "890:1029", "2700:3001", "2749:2930", "400:726", None, None, None,
    ]  # fmt: skip
    from priors.drives.kitti_odometry import RAW_DRIVE

    for name in KITTI:
        drives = SEQUENCES[name].drives
        assert RAW_DRIVE[drives["kitti_odometry"]] == (drives["kitti_raw"], 0), "the same frames by the same numbers"
    assert set(get_args(get_type_hints(SequenceArguments)["sequence"])[0].__args__) == set(SEQUENCES)


@pytest.mark.parametrize("levels", range(4))
def test_a_raw_drive_is_found_in_itself_and_above(tmp_path: Path, short: Sequence, levels: int) -> None:
    drive = raw(tmp_path / "data" / "kitti")
    found = find("study-1", [drive, *drive.parents][levels])
    assert (found.place.path.resolve(), found.place.dataset, found.camera) == (drive.resolve(), "kitti_raw", "image_02")
    expect_whole("study-1", open_drive(found.place.path))


def test_odometry_has_the_same_frames(tmp_path: Path, short: Sequence) -> None:
    root = write_odometry(tmp_path, 6, "00")
    found = find("study-1", root)
    assert (found.place.path.name, found.place.dataset, found.camera) == ("00", "kitti_odometry", "image_2")
    drive = open_drive(found.place.path, options=DriveOptions(camera=found.camera))
    expect_whole("study-1", drive)
    raw(tmp_path)
    assert find("study-1", tmp_path).place.dataset == "kitti_raw"
    assert find("study-1", tmp_path, "kitti_odometry").place.dataset == "kitti_odometry"


def test_an_argoverse_log_is_taken_whole_at_5_hz(tmp_path: Path) -> None:
    write_argoverse_tracking(tmp_path / "argoverse-tracking" / "train1" / LOG, 3)
    found = find("study-6", tmp_path)
    assert (found.place.path.name, found.camera) == (LOG, "stereo_front_left")
    drive = open_drive(found.place.path, options=DriveOptions(camera=found.camera))
    expect_whole("study-6", drive)
    rate = Rate.of(drive, range(3))
    assert rate.hz == pytest.approx(SEQUENCES["study-6"].hz) and rate.sparse_step == 2


def test_what_is_missing_is_named_as_a_file(tmp_path: Path, short: Sequence) -> None:
    with pytest.raises(DataError, match="nowhere: no such folder: --sequence study-1 needs KITTI's drive"):
        find("study-1", tmp_path / "nowhere")
    with pytest.raises(DataError, match="2011_10_03_drive_0034_sync: no such folder, nor 3 folders down: --sequence"):
        find("study-4", tmp_path)
    drive = raw(tmp_path)
    lost = drive / "image_02" / "data" / "0000000003.png"
    lost.unlink()
    told = f"{lost}: no such file: --sequence study-1: 1 of its 4 frames are missing"
    with pytest.raises(DataError, match=told):
        expect_whole("study-1", open_drive(drive))
    shutil.rmtree(drive / "image_02")
    with pytest.raises(DataError, match=rf"{drive / 'image_02'}: no such folder: --sequence study-1 needs"):
        find("study-1", tmp_path)


@pytest.mark.parametrize(("flag", "value"), [("--frames", "0:3"), ("--drive", "00"), ("--camera", "image_00")])
def test_what_a_sequence_says_is_not_said_twice(flag: str, value: str) -> None:
    options = {} if flag == "--frames" else {flag[2:]: value}
    args = SequenceArguments(part=DriveOptions(**options), sequence="study-1")
    with pytest.raises(UsageError, match=f"{flag}: --sequence study-1 says it: leave out one or the other"):
        args.frame_range(value if flag == "--frames" else None)


def test_a_printed_command_names_the_drive_as_it_was_typed() -> None:
    part = DriveOptions(camera="image_00", truth=Path("depth"), poses="recorded")
    words = SequenceArguments(Path("d"), "kitti_raw", part).typed_drive()
    assert words == [
        "d",
        "--dataset",
        "kitti_raw",
        *["--camera", "image_00", "--truth", "depth", "--poses", "recorded"],
    ]
    assert SequenceArguments(Path("d"), sequence="study-2").typed_drive() == ["d", "--sequence", "study-2"]
    assert SequenceArguments().typed_drive() == []


def test_commands_take_a_sequence(
    tmp_path: Path, short: Sequence, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    raw(tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    build = ["build", "--method", "lidar", "--lidar.sweeps", "1"]
    assert PRIORS.run([*build, "--sequence", "study-1", "--dry-run"]) == 0
    told = capsys.readouterr()
    assert "image_02, frames 2:6" in told.err and "4 to compute" in told.out
    for command in (build, ["fit"], ["study"]):
        program = PRIORS if command is build else NERF
        assert program.run([command[0], "data", *command[1:], "--sequence", "study-2"]) == 1
        lines = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
        assert len(lines) == 1 and "0000000890.png: no such file: --sequence study-2" in lines[0]
        assert program.run([command[0], "data", *command[1:], "--sequence", "study-1", "--frames", "0:3"]) == 2
        capsys.readouterr()


@pytest.mark.slow
def test_a_fit_of_a_sequence_is_named_after_it(
    tmp_path: Path, short: Sequence, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    raw(tmp_path / "data")
    monkeypatch.chdir(tmp_path)
    assert PRIORS.run(["build", "--sequence", "study-1", "--method", "lidar", "--lidar.sweeps", "1"]) == 0
    assert len(list(tmp_path.glob("cache/*/lidar-*/depth/*.png"))) == 4
    assert NERF.run(["fit", "data", "--sequence", "study-1", "--prior", "cache", "--steps", "1", "--rays", "64"]) == 0
    assert "4 of 4 frames train" in capsys.readouterr().err
    (run,) = [path.name for path in (tmp_path / "runs").iterdir() if path.name[0] != "."]
    assert run.startswith("study-1-mip360-dense-l1")


@pytest.mark.slow
def test_table_5_is_the_same_command_on_an_argoverse_log(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_argoverse_tracking(tmp_path / "argoverse-tracking" / "train1" / LOG, 10)
    monkeypatch.chdir(tmp_path)
    build = ["build", "--sequence", "study-6", "--method", "lidar", "--lidar.sweeps", "1", "--lidar.no-stereo"]
    assert PRIORS.run(build) == 0  # the pair's images are flat: they would deny every point
    study = ["study", "--sequence", "study-6", "--priors", "none", "cache", "--field", "warp", "--seed", "0"]
    assert NERF.run([*study, "--preset", "paper"]) == 0
    capsys.readouterr()
    page = (tmp_path / "study" / "study-6" / "study.md").read_text()
    assert "| warp | GT Depth |" in page and "no Argoverse log" not in page and f"Drive {LOG}" in page
    sparse = open_run(next((tmp_path / "study" / "study-6").glob("warp-sparse-lidar-*"))).config
    assert sparse.sparse_step == 2 and sparse.parts(10) == ([0, 2, 4, 6, 8], [9])


def test_studies_of_sequences_lie_apart() -> None:
    assert StudyArguments(sequence="study-3").folder == Path("study/study-3")
    assert StudyArguments(sequence="study-3", out=Path("mine")).folder == Path("mine")
    assert StudyArguments().folder == Path("study")
