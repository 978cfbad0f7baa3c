"""`priors build`: which method and which drive, where the user names none."""

from collections.abc import Callable
from pathlib import Path

import pytest
from factories import write_folder

from cli.console import guarded
from cli.priors import build as command
from cli.priors import check

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """Run `priors build` in an empty folder; returns exit code, output and errors."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str, what: object = command) -> tuple[int, str, str]:
        code = guarded(lambda: what.run(list(arguments)))  # type: ignore[attr-defined]
        done = capsys.readouterr()
        return code, done.out, done.err

    return call


def refused(done: tuple[int, str, str], *says: str) -> None:
    """It ended in one error, by a usage error's code, before anything was computed."""
    code, _, err = done
    assert code == 2 and not Path("cache").exists()
    assert err.count("error:") == 1 and all(part in err for part in says), err


def test_without_a_method_it_says_what_the_drive_has(run: Run) -> None:
    write_folder(Path("mine"), ("a",))
    refused(run("mine"), "mine has a stereo pair", "priors build mine --method stereo")
    refused(run("--clip", "40"), "drive: mine", "priors build --clip 40 --method stereo")
    write_folder(Path("alone"), ("a",), right=False)
    refused(run("alone"), "alone has images alone", "--method auto takes mono")


def test_a_mistyped_method_is_answered_with_those_there_are(run: Run) -> None:
    write_folder(Path("mine"), ("a",))
    told = "--method sterio: choose one of auto, completion, fused, lidar, mono, stereo: did you mean stereo?"
    refused(run("mine", "--method", "sterio"), told)


def test_a_frame_that_failed_is_named_once(run: Run, raw_drive: Path) -> None:
    (raw_drive.parent / "calib_imu_to_velo.txt").unlink()
    code, _, err = run(str(raw_drive), "--method", "lidar", "--lidar.sweeps", "3")
    lines = [line for line in err.splitlines() if "calib_imu_to_velo.txt" in line]
    assert code == 1 and lines and all(line.count("frame 00") == 1 for line in lines), err


def test_auto_takes_it_and_says_so(run: Run) -> None:
    write_folder(Path("mine"), ("a",), right=False)
    (Path("mine") / "depth").rename("mine/sparse")
    code, out, err = run("--method", "auto", "--completion.reach-px", "9", "--stereo.model", "cfnet", "--dry-run")
    assert code == 0 and "cache/mine/completion-" in out
    assert "drive: mine\n" in err and "method: completion: it has sparse depth maps and no stereo pair\n" in err
    assert "--stereo.model: not used by completion\n" in err and "reach" not in err


def test_maps_whose_manifest_is_damaged_and_key_another_are_told(run: Run) -> None:
    """This build would make its maps in another folder: an earlier version's key cannot be made out."""
    write_folder(Path("mine"), ("a",), right=False)
    (Path("mine") / "depth").rename("mine/sparse")
    folder = Path("cache/mine/completion-0123456789")
    (folder / "depth").mkdir(parents=True)
    (folder / "depth" / "a.png").write_bytes(b"")
    for text in ("{", None):
        (folder / "manifest.json").unlink(missing_ok=True)
        if text is not None:
            (folder / "manifest.json").write_text(text)
        code, _, err = run("mine", "--method", "completion", "--dry-run")
        told = [line for line in err.splitlines() if f"left out: {folder}" in line]
        assert code == 0 and len(told) == 1 and "put manifest.json back from a copy" in told[0]
    (folder / "manifest.json").write_text('{"format": 99}')
    assert "left out" not in run("mine", "--method", "completion", "--dry-run")[2], "not ours to judge"


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        (("--lidar.sweeps", "3"), "--lidar.sweeps: a flag of --method lidar, not of stereo"),
        (("--mono.adapt=lidar", "--mono.adapt-s=5"), "--mono.adapt, --mono.adapt-s: flags of --method mono"),
        (("--completion.lidar.no-motion",), "--completion.lidar.no-motion: a flag of --method completion"),
    ],
)
def test_flags_of_another_method_are_refused(run: Run, flags: tuple[str, ...], says: str) -> None:
    write_folder(Path("mine"), ("a",))
    refused(run("mine", "--method", "stereo", *flags), says)


@pytest.mark.parametrize(
    ("typed", "says"),
    [
        ("stereo --stereo.size m", "--stereo.size: not used as --method stereo is set: it is read with --stereo.model"),
        ("stereo --stereo.runtime=fp32 --stereo.model classical", "--stereo.runtime: not used"),
        ("stereo --stereo.model cfnet --stereo.weights x.onnx --stereo.size l", "--stereo.size: not used"),
        ("completion --completion.size=m", "with --completion.model mffnet"),
        ("completion --completion.source velodyne_raw --completion.lidar.no-motion", "with --completion.source lidar"),
        ("mono --mono.adapt_s 5", "with --mono.adapt lidar"),
        ("mono --mono.adapt lidar --mono.align-to lidar", "with --mono.align scale"),
        ("mono --mono.align scale --mono.align-per frame --mono.hold-out none", "--mono.hold-out: not used"),
        ("mono --mono.weights x.onnx --mono.size s", "--mono.size: not used"),
    ],
)
def test_flags_that_the_chosen_model_does_not_read_are_refused(run: Run, typed: str, says: str) -> None:
    write_folder(Path("mine"), ("a",))
    refused(run("mine", "--method", *typed.split()), says)


def test_what_turns_out_unread_is_named(run: Run) -> None:
    write_folder(Path("mine"), ("a",), right=False)
    (Path("mine") / "depth").rename("mine/sparse")
    typed = ("--completion.lidar.sweeps", "3", "--completion.size", "m", "--dry-run")
    for method in ("auto", "completion"):
        code, _, err = run("mine", "--method", method, *(typed if method == "auto" else (*typed[:2], typed[-1])))
        assert code == 0 and "--completion.lidar.sweeps: not used here: it is read with --completion.source" in err
        assert ("--completion.size: not used here" in err) == (method == "auto")


def test_frames_that_are_not_there_are_told_before_anything_is_compiled(run: Run) -> None:
    write_folder(Path("mine"), ("0", "1"))
    code, out, err = run("mine", "--method", "stereo", "--frames", "7:9")
    assert code == 2 and not out and len(err.splitlines()) == 1
    assert "--frames 7:9" in err and "the drive has 0:2" in err


@pytest.mark.parametrize(("most_px", "fits"), [("239", True), ("240", False), ("4000", False)])
def test_no_disparity_is_searched_that_the_image_cannot_have(run: Run, most_px: str, fits: bool) -> None:
    write_folder(Path("mine"), ("a",))
    done = run("mine", "--method", "stereo", "--stereo.max-disparity-px", most_px, "--dry-run")
    assert fits == (done[0] == 0)
    if not fits:
        refused(done, f"--stereo.max-disparity-px {most_px}: expected less than the image's width, 240 pixels")


def test_without_a_drive_it_lists_them_or_offers_the_street(run: Run) -> None:
    refused(run("--method", "stereo"), "no drive in", "priors street street/")
    for name in ("one", "two"):
        write_folder(Path(name), ("a",))
    refused(run("--method", "stereo"), "2 drives", "\n  priors build one --method stereo\n  priors build two --method")
    refused(run(what=check), "\n  priors check one\n")
