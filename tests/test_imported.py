"""Imports: names joined to frames, numbers turned into metres, the comparison that finds a wrong unit or kind."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from factories import BASELINE_M, FX, SIZE, write_folder, write_raw
from hypothesis import given
from hypothesis import strategies as st
from layouts.nerfstudio import write_nerfstudio
from layouts.posed import seen_by

from cli.priors import PROGRAM
from priors import cache, codecs, imported
from priors.drives import CameraDrive, open_drive
from priors.errors import DataError, UsageError
from priors.geometry import rays
from priors.imported import Encoding
from priors.imported.match import match
from priors.types import Drive

pytestmark = pytest.mark.datasets
KINDS = ("depth", "range", "disparity", "inverse")


def numbers_of(kind: str, depth_m: np.ndarray, drive: Drive) -> np.ndarray:
    """What a map of this kind holds, by the definitions."""
    if kind == "range":
        return depth_m * np.linalg.norm(rays(drive[0].camera), axis=-1)
    return {"depth": depth_m, "inverse": 1 / depth_m, "disparity": FX * BASELINE_M / depth_m}[kind]


@pytest.fixture
def drive(tmp_path: Path) -> CameraDrive:
    """Three frames with a pair and truth, whose depth differs by frame."""
    root = write_folder(tmp_path / "own", ["0000000003", "0000000004", "0000000005"])
    for number, path in enumerate(sorted((root / "depth").iterdir())):
        codecs.write_depth_png(path, codecs.read_depth_png(path) + number * 0.25)
    return open_drive(root)


def write_maps(folder: Path, drive: Drive, kind: str, factor: float, name: str = "{}.npy") -> Path:
    """Write each frame's true depth as somebody would; one pixel of the first row has no value."""
    folder.mkdir(parents=True, exist_ok=True)
    for frame in drive:
        numbers = numbers_of(kind, frame.truth().depth_m.astype(np.float64), drive) / factor
        numbers[0, 0] = 0
        path = folder / name.format(frame.id)
        if path.suffix == ".npy":
            np.save(path, numbers.astype(np.float32))
        else:
            codecs.write_depth_png(path, numbers / 256)
    return folder


@pytest.mark.parametrize("unit", ["m", "1/256", "mm", "cm", "0.5"])
@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_and_unit_becomes_metres(tmp_path: Path, drive: CameraDrive, kind: str, unit: str) -> None:
    if kind in ("disparity", "inverse") and unit in ("mm", "cm"):
        with pytest.raises(UsageError, match=f"--unit {unit}: expected a fraction, 1/256 say, or 1 for --kind {kind}"):
            Encoding(unit, kind)
        return
    factor = {"m": 1, "1/256": 1 / 256, "mm": 1e-3, "cm": 1e-2}.get(unit, 0.5)
    folder = write_maps(tmp_path / "maps", drive, kind, factor)
    job = imported.prepare(drive, folder, Encoding(unit, kind), tmp_path / "cache")
    assert [finding.level for finding in job.compare()] == ["ok"]
    report = job.run()
    assert report.written == drive.ids and not report.failed
    for frame in drive:
        found, true_m = report.prior.read(frame.id).depth_m, frame.truth().depth_m
        assert found[0, 0] == 0
        np.testing.assert_allclose(found.ravel()[1:], true_m.ravel()[1:], rtol=1e-5, atol=0.51 / 256)


def test_one_encoding_is_one_prior_and_others_are_others(tmp_path: Path, drive: CameraDrive) -> None:
    folder = write_maps(tmp_path / "maps", drive, "depth", 1.0)

    def place(unit: str | None, kind: str = "depth") -> str:
        return imported.prepare(drive, folder, Encoding(unit, kind), tmp_path / "cache").prior.name

    assert place(None) == place("m") == place("1") and place("mm") == place("1/1000") == place("0.001")
    several = {place(unit, kind) for unit in ("m", "0.5") for kind in KINDS}
    before = place("m")
    np.save(folder / "0000000004.npy", np.ones(SIZE, np.float32))
    assert len(several | {place("mm"), place("m")}) == len(several) + 2
    assert before != place("m") and before.startswith("imported-")


@pytest.mark.parametrize(
    ("name", "joined"),
    [
        ("{}.png", True),
        ("{}_disp.png", True),
        ("depth_{}.png", True),
        ("left-{}-10.png", True),
        ("3{}.png", False),
    ],
)
def test_names_are_joined(tmp_path: Path, drive: CameraDrive, name: str, joined: bool) -> None:
    folder = tmp_path / "maps"
    folder.mkdir()
    for id_ in drive.ids:
        (folder / name.format(id_.lstrip("0"))).touch()  # 3, 4, 5: numbers
    if joined:
        found = match(drive.ids, folder)
        assert {id_: path.name for id_, path in found.items()} == {i: name.format(i.lstrip("0")) for i in drive.ids}
    else:
        with pytest.raises(DataError, match=r"no map of a frame: frames are named 0000000003, .* maps 33, 34, 35"):
            match(drive.ids, folder)


@given(
    st.sets(st.integers(0, 300), min_size=2, max_size=6), st.sampled_from(["", "a", "cam1_"]),
    st.sampled_from(["", "_depth", "-v2"]), st.sampled_from(["", "IMG_"]),
)  # fmt: skip
def test_numbers_of_many_names_are_joined(
    tmp_path_factory: pytest.TempPathFactory, numbers: set[int], before: str, after: str, of_images: str
) -> None:
    folder = tmp_path_factory.mktemp("maps")
    ids = [f"{of_images}{number:04d}" for number in sorted(numbers)]
    for number in numbers:
        (folder / f"{before}{number:06d}{after}.npy").touch()
    found = match(ids, folder)
    assert {id_: path.name for id_, path in found.items()} == {
        f"{of_images}{number:04d}": f"{before}{number:06d}{after}.npy" for number in numbers
    }


@pytest.mark.parametrize(
    ("kind", "factor", "said", "message"),
    [
        ("depth", 1e-3, Encoding("1/256"), r"3\.9\d times that of the truth: --unit mm"),
        ("depth", 1 / 256, Encoding("m"), r"their depth is 25\d times that of the truth: --unit 1/256"),
        ("depth", 1.0, Encoding("3"), r"3 times that of the truth: --unit m\b"),
        ("inverse", 0.05, Encoding("m"), "--kind disparity, or --kind inverse"),
    ],
)
def test_a_wrong_unit_or_kind_is_named_and_refused(
    tmp_path: Path, drive: CameraDrive, kind: str, factor: float, said: Encoding, message: str
) -> None:
    folder = write_maps(tmp_path / "maps", drive, kind, factor)
    (finding,) = imported.prepare(drive, folder, said, tmp_path / "cache").compare()
    assert finding.level == "fatal"
    assert re.search(message, finding.message)


def test_the_lidar_is_asked_first_and_nothing_may_be_there(tmp_path: Path) -> None:
    raw = open_drive(write_raw(tmp_path / "raw"))
    folder = tmp_path / "maps"
    folder.mkdir()
    for frame in raw:
        np.save(folder / f"{frame.id}.npy", np.full(SIZE, 1000.0, np.float32))
    (finding,) = imported.prepare(raw, folder, Encoding(), tmp_path / "cache").compare()
    assert finding.level == "fatal" and "LiDAR" in finding.message
    write_nerfstudio(tmp_path / "scene")
    scene = open_drive(tmp_path / "scene")
    scene.maps = {}
    (finding,) = imported.prepare(scene, tmp_path / "scene" / "depth", Encoding("mm"), tmp_path / "cache").compare()
    assert finding.level == "note" and "scale is not checked" in finding.message


def test_maps_beside_a_bent_image_are_straightened_with_it(tmp_path: Path) -> None:
    views = write_nerfstudio(tmp_path / "scene")
    scene = open_drive(tmp_path / "scene")
    job = imported.prepare(scene, tmp_path / "scene" / "depth", Encoding("mm"), tmp_path / "cache")
    report = job.run()
    for frame, view in zip(scene, views, strict=True):
        _, true_m = seen_by(view.T_world_cam, frame.camera.K, frame.camera.size)
        assert np.abs(report.prior.read(frame.id).depth_m / true_m - 1).max() < 0.01


def test_the_command_imports_scores_and_goes_on(
    tmp_path: Path, drive: CameraDrive, capsys: pytest.CaptureFixture[str]
) -> None:
    maps = write_maps(tmp_path / "theirs", drive, "depth", 1 / 256, "{}.png")
    folder, data = str(tmp_path / "cache"), str(drive.folder)
    arguments = ["import", data, "--depth", str(maps), "--cache", folder]
    assert PROGRAM.run(arguments) == 2
    assert "--unit 1/256 is KITTI's, --unit mm nerfstudio's" in capsys.readouterr().err
    assert PROGRAM.run([*arguments, "--unit", "mm"]) == 1
    assert "--unit 1/256; --unchecked imports them as they are" in capsys.readouterr().err
    assert not (tmp_path / "cache").exists()
    assert PROGRAM.run([*arguments, "--unit", "1/256"]) == 0
    prior = cache.only(tmp_path / "cache")
    assert prior.manifest["source"] == "theirs" and prior.manifest["config"] == {"unit": "1/256", "kind": "depth"}
    assert "3 maps imported" in capsys.readouterr().out
    prior.depth_path(drive.ids[1]).write_bytes(prior.depth_path(drive.ids[1]).read_bytes()[:100])
    assert PROGRAM.run([*arguments, "--unit", "1/256"]) == 0
    assert "1 maps imported, 2 there already" in capsys.readouterr().out
    assert PROGRAM.run([*arguments, "--unit", "mm", "--unchecked"]) == 0
    assert PROGRAM.run(["eval", folder]) == 0
    printed = capsys.readouterr().out
    assert "imported theirs unit=1/256" in printed and "imported theirs unit=1/1000" in printed
    assert PROGRAM.run(["check", folder]) == 0
    assert PROGRAM.run(["list", folder]) == 0


def test_a_bad_map_spoils_its_own_frame(tmp_path: Path, drive: CameraDrive, capsys: pytest.CaptureFixture[str]) -> None:
    maps = write_maps(tmp_path / "maps", drive, "depth", 1.0)
    np.save(maps / "0000000003.npy", np.ones((10, 20), np.float32))
    (maps / "0000000005.npy").write_bytes(b"no map")
    assert PROGRAM.run(["import", str(drive.folder), "--depth", str(maps), "--cache", str(tmp_path / "cache")]) == 1
    printed = capsys.readouterr()
    assert "is 20x10, the image 240x96: resize it, without blending" in printed.err
    assert "0000000005.npy: cannot be read" in printed.err and "1 maps imported" in printed.out


def test_bad_arguments_are_one_line(tmp_path: Path, drive: CameraDrive) -> None:
    for unit in ("feet", "0", "-1", "1/0", "nan"):
        with pytest.raises(UsageError, match=f"--unit {unit}: expected m, cm, mm or a fraction"):
            Encoding(unit)
    with pytest.raises(UsageError, match="--unit px"):
        Encoding("px", "depth")
    with pytest.raises(DataError, match="no such folder: --depth names the folder of the maps"):
        imported.prepare(drive, tmp_path / "gone", Encoding(), tmp_path)
    with pytest.raises(DataError, match=r"no depth maps \(\.png, \.npy, \.npz, \.pfm\)"):
        imported.prepare(drive, drive.folder, Encoding(), tmp_path)
    write_nerfstudio(tmp_path / "scene")
    scene, encoding = open_drive(tmp_path / "scene"), Encoding("1/256", "disparity")
    job = imported.prepare(scene, tmp_path / "scene" / "depth", encoding, tmp_path)
    assert "disparity needs the pair's baseline" in next(iter(job.run().failed.values()))


def test_an_imported_prior_is_no_method(tmp_path: Path, drive: CameraDrive) -> None:
    """Its manifest is that of every prior: a stranger can read it."""
    maps = write_maps(tmp_path / "maps", drive, "depth", 1.0)
    report = imported.prepare(drive, maps, Encoding(), tmp_path / "cache").run()
    manifest = json.loads((report.prior.folder / "manifest.json").read_text())
    assert manifest["method"] == "imported" and manifest["key"] == report.prior.name.removeprefix("imported-")
    assert cache.load(report.prior.folder).drive["path"] == str(drive.folder)
