"""`priors export` as it is typed: what is written, what is told, what is refused."""

import shutil
from pathlib import Path

import pytest
from exported import read_ply, truth_prior
from factories import write_folder

from cli.console import guarded
from cli.priors import export
from priors.cache import Prior
from priors.drives import open_drive

pytestmark = pytest.mark.datasets


@pytest.fixture
def prior(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Prior:
    """A prior of three frames in cache/ of the current folder."""
    monkeypatch.chdir(tmp_path)
    return truth_prior(open_drive(write_folder(tmp_path / "own", [f"{n:010d}" for n in range(3)])), tmp_path / "cache")


def typed(*words: object) -> int:
    return guarded(lambda: export.run([str(word) for word in words]))


def refused(capsys: pytest.CaptureFixture[str], *words: object, code: int = 2) -> str:
    """Type what must be refused; returns what is said."""
    assert typed(*words) == code
    said = capsys.readouterr().err
    assert "Traceback" not in said and said.startswith("error:")
    return said


@pytest.mark.parametrize("to", ["nerfstudio", "colmap", "3dgs"])
def test_a_folder_is_written_once_and_again(to: str, prior: Prior, capsys: pytest.CaptureFixture[str]) -> None:
    assert typed("--to", to, "--frames", "0:2", "--voxel-m", "0.5") == 0
    folder = Path("exports") / f"own-truth-aa-{to}"
    first = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert {"README.txt", "export.json"} < {path.name for path in first}
    said = capsys.readouterr().out
    assert str(folder) in said.splitlines()[0]
    if to != "colmap":
        last = said.splitlines()[-1]
        assert last.startswith("ns-train depth-nerfacto " if to == "nerfstudio" else "python train.py -s ")
    assert typed(prior.folder, "--to", to, "--frames", "0:2", "--voxel-m", "0.5") == 0
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == first
    assert "holds another export" in refused(capsys, "--to", to, "--voxel-m", "0.5", code=1)


def test_a_cloud_is_one_file(prior: Prior, capsys: pytest.CaptureFixture[str]) -> None:
    assert typed("--to", "ply", "--clip", "12", "--voxel-m", "0.3", "--out", "new/a.ply") == 0
    points, comments = read_ply(Path("new/a.ply"))
    assert len(points) > 0 and points["depth"].max() <= 12 and points["views"].max() == 2
    assert points["confidence"].min() >= 0.5 and any("metres" in comment for comment in comments)
    assert f"{len(points)} points" in capsys.readouterr().out
    assert typed("--to", "ply", "--voxel-m", "2", "--points", "50", "--out", "new/a.ply") == 0
    assert len(read_ply(Path("new/a.ply"))[0]) == 50
    Path("theirs.ply").write_bytes(b"ply\nformat ascii 1.0\nend_header\n")
    assert "no export wrote it" in refused(capsys, "--to", "ply", "--out", "theirs.ply", code=1)


def test_a_submission_says_what_is_missing(prior: Prior, capsys: pytest.CaptureFixture[str]) -> None:
    assert typed("--to", "kitti") == 0
    said = capsys.readouterr().out
    assert "own-truth-aa-kitti.zip" in said and "997 of 1000 test images are missing" in said


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("--to kitti --voxel-m 0.2", "--voxel-m: --to kitti does not read it, nerfstudio, colmap, 3dgs and ply do"),
        ("--to colmap --masks sky", "--masks: --to colmap does not read it, nerfstudio does"),
        ("--to onnx --net cfnet-s --clip 80", "--clip: --to onnx does not read it"),
        ("--to onnx --net cfnet-s --frames 0:2", "--frames: --to onnx does not read it"),
        ("--to ply --net cfnet-s", "--net: --to ply does not read it"),
        ("--to ply --benchmark completion", "--benchmark: --to ply does not read it"),
        ("--to ply --out cloud.xyz", "ends in .ply"),
        ("--to gltf", "--to gltf"),
        ("--to ply --frames 9:99", "no frames there"),
        ("--to onnx", "name a network"),
        ("", "--to"),
    ],
)
def test_what_cannot_be_meant_is_refused(
    words: str, says: str, prior: Prior, capsys: pytest.CaptureFixture[str]
) -> None:
    if words == "--to onnx":
        shutil.rmtree("cache")
    assert says in refused(capsys, *words.split())
    assert not Path("exports").exists()


def test_several_priors_are_listed_as_commands(prior: Prior, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(prior.folder, prior.folder.with_name("truth-bb"))
    said = refused(capsys, "--to", "ply", "--voxel-m", "1")
    assert "priors export cache/own/truth-aa --to ply --voxel-m 1" in said and "truth-bb" in said


def test_a_damaged_map_is_named_and_the_rest_is_written(prior: Prior, capsys: pytest.CaptureFixture[str]) -> None:
    path = prior.depth_path(prior.ids()[1])
    path.write_bytes(path.read_bytes()[:-30])
    assert typed("--to", "colmap", "--voxel-m", "0.5") == 1
    said = capsys.readouterr()
    assert f"left out: frame {path.stem}" in said.err and "2 images" in said.out
