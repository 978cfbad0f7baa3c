"""Caches and runs that commit 36e3991 made (tests/data/36e3991) are listed, scored, shown, resumed and rendered."""

import json
import lzma
import re
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from safetensors.torch import load_file

from cli import nerf as nerf_command
from cli import priors as priors_command
from nerf import checkpoint
from nerf.report import Report
from nerf.run import claim, open_run
from priors import cache, codecs, methods
from priors.nets import weights
from priors.records import upgrade

BIN = Path(sys.executable).parent
DATA = Path(__file__).parent / "data" / "36e3991"
MADE_IN = "/tmp/roadprior-36e3991"
DRIVE = "street_0007_sync"
LIDAR = "lidar-5bbb468a88"
STUDIED = "ngp-2-lidar-5bbb468a88-kl-keep0.9-seed0"
BUILT = {
    LIDAR: "lidar --frames 0:3",
    "stereo-118841c6e4": "stereo --sky mask --clip 80 --frames 0:2",
    "stereo-ed20d59641": "stereo --stereo.model cfnet --stereo.runtime fp32 --stereo.offset-px 0.5 0 1.1 -0.7 "
    "--stereo.scale 0.981 --stereo.resize none --frames 0:1",
    "completion-b0e5c5d0d2": "completion --completion.cleaning full --frames 0:1",
    "completion-e97a20c511": "completion --completion.model mffnet --completion.runtime fp32 "
    "--completion.cleaning full --frames 0:1",
    "mono-b33d957db5": "mono --mono.runtime fp32 --mono.adapt lidar --mono.adapt-s 1 --mono.frames 0:3 --frames 0:1",
}
"""Folder -> what it was built by."""


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the old results, as if they had been made in it; commands run there."""
    folder = tmp_path / "home"
    shutil.copytree(DATA, folder)
    for path in folder.rglob("*.json"):
        path.write_text(path.read_text().replace(MADE_IN, str(folder)))
    packed = folder / "fits" / "stopped" / "checkpoint.safetensors.xz"
    packed.with_suffix("").write_bytes(lzma.decompress(packed.read_bytes()))
    monkeypatch.chdir(folder)
    return folder


def prior(home: Path, name: str = LIDAR) -> cache.Prior:
    return cache.load(home / "maps" / DRIVE / name)


def priors(*words: object) -> int:
    return priors_command.PROGRAM.run([str(word) for word in words])


def nerf(*words: object) -> int:
    return nerf_command.PROGRAM.run([str(word) for word in words])


def build(name: str, frames: str | None = None) -> int:
    """Give the command that built a prior again, perhaps for other frames."""
    words = BUILT[name].split()
    words[-1] = frames or words[-1]
    return priors("build", "street", "--cache", "maps", "--method", *words)


CHANGED = ("stereo", "mono")
"""Methods whose maps are others now, by their VERSION: their confidences were mended by what came true."""


@pytest.fixture
def as_then(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let methods and the sky mask have the version of then, and classical stereo choose no surface, as then."""
    monkeypatch.setattr("priors.methods._stereo_classical.load_choice", lambda: lambda maps, left, sky: maps[0])
    for name in CHANGED:
        monkeypatch.setattr(methods.config_type(name), "VERSION", 1)
    monkeypatch.setattr(import_module("priors.build.prepare"), "SKY_VERSION", 1)
    monkeypatch.setattr("priors.sky.VERSION", 1)


def with_its_weights(monkeypatch: pytest.MonkeyPatch, made: cache.Prior) -> None:
    """Let the network's weights be those of then: they may have been trained again since."""
    then = made.manifest["weights"]
    if then is not None:
        monkeypatch.setattr(weights, "digest", lambda path: then)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_installed_command_lists_them(home: Path) -> None:
    told = subprocess.run([BIN / "priors", "list", "maps"], capture_output=True, text=True, check=True).stdout
    counts = {name: int(count) for name, count in re.findall(r"(\w+-[0-9a-f]{10}) +(\d+) ", told)}
    assert counts == {name: int(words[-1]) for name, words in BUILT.items()}
    assert re.search(r"^ *street_0007_sync +stereo .*cfnet.* ", told, re.MULTILINE)


def test_they_are_scored_as_then(home: Path) -> None:
    path = prior(home, "completion-b0e5c5d0d2").folder / "metrics.json"
    then = json.loads(path.read_text())["metrics"]
    assert priors("eval", "maps") == 0
    assert json.loads(path.read_text())["metrics"]["image"] == pytest.approx(then["image"], rel=1e-6)
    assert len(list(home.glob("maps/*/*/metrics.json"))) == len(BUILT)


def test_their_pictures_are_drawn(home: Path) -> None:
    assert priors("show", "maps", "--frames", "0:1", "--out", "pictures") == 0
    assert codecs.read_image(home / "pictures" / DRIVE / "0000000000.jpg").shape[0] > 6 * 100


@pytest.mark.usefixtures("as_then")
@pytest.mark.parametrize("name", BUILT)
def test_a_build_finds_them_and_computes_nothing(
    home: Path, name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    made, before = prior(home, name), contents(home / "maps")
    with_its_weights(monkeypatch, made)
    assert build(name) == 0
    told = capsys.readouterr().out
    assert name in told
    assert re.search(rf"^ +0 +{len(made.ids())} +0 +0 ", told, re.MULTILINE), "built, cached, skipped, failed"
    assert contents(home / "maps") == before


def test_maps_of_a_changed_method_stand_beside_the_old_ones(home: Path) -> None:
    before = contents(home / "maps")
    assert build("stereo-118841c6e4", "0:1") == 0
    after = contents(home / "maps")
    assert {path: after[path] for path in before} == before
    made = [cache.load(folder) for folder in (home / "maps" / DRIVE).glob("stereo-*")]
    assert sorted(one.manifest.get("version", 1) for one in made) == [1, 1, methods.config_type("stereo").VERSION]


@pytest.mark.usefixtures("as_then")
@pytest.mark.parametrize("name", [LIDAR, "stereo-118841c6e4", "completion-b0e5c5d0d2"])
def test_a_partly_built_one_is_gone_on_with_in_its_folder(home: Path, name: str) -> None:
    made = prior(home, name)
    last = made.ids()[-1]
    then, path = made.read(last), made.depth_path(last)
    path.unlink()
    before = contents(home / "maps")
    assert build(name) == 0
    after = contents(home / "maps")
    own = {str(path.relative_to(home / "maps"))}
    if name.startswith("stereo"):  # which tells its relative error now
        own.add(str(made.path("confidence_relative", last).relative_to(home / "maps")))
    assert after.keys() - before.keys() == own, "no other folder, nothing else"
    now = prior(home, name)
    assert then.confidence is not None
    again = now.read(last)
    both = again.valid & then.valid if "--sky mask" in BUILT[name] else np.ones_like(then.valid)
    assert np.mean(again.valid == then.valid) > 0.96, "the sky mask is another one since"
    assert_same(again.depth_m[both], then.depth_m[both])
    assert now.manifest["config"] == upgrade(methods.config_type(made.method), made.manifest["config"])
    assert now.manifest["key"] == made.manifest["key"]


def assert_same(now: np.ndarray, then: np.ndarray) -> None:
    """The same map, as another kind of CPU may round it."""
    near = np.isclose(now, then, rtol=0.01, atol=1 / 128)
    assert near.mean() > 0.999


@pytest.mark.usefixtures("as_then")
def test_mono_goes_on_with_the_weights_that_it_adapted(
    home: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What decides those weights has a key of its own; any weights of its network stand in for them here."""
    made = prior(home, "mono-b33d957db5")
    with_its_weights(monkeypatch, made)
    adapted = made.folder.parent / "weights" / "mono-83803d16ab.safetensors"
    adapted.parent.mkdir()
    shutil.copyfile(weights.find("bts", "m"), adapted)
    assert build(made.name, "0:2") == 0
    assert f"weights adapted before: {adapted.relative_to(home)}" in capsys.readouterr().err
    assert prior(home, made.name).ids() == ["0000000000", "0000000001"]


def test_a_run_begins_with_an_old_prior(home: Path) -> None:
    assert nerf("fit", "street", "--prior", f"maps/{DRIVE}/{LIDAR}", "--steps", 2, "--run", "fits/new") == 0
    assert open_run(home / "fits" / "new").config.prior == str(prior(home).folder)


def test_an_old_run_is_gone_on_with_by_the_command_that_began_it(home: Path) -> None:
    """The study's run, whose checkpoint is not kept: one of today stands in for it, under the old config."""
    old = home / "study" / STUDIED
    words = Report.load(old / "metrics.json").info["command"].split()[1:]
    assert nerf(*words) == 0
    shutil.copyfile(DATA / "study" / STUDIED / "config.json", old / "config.json")
    (old / "config.json").write_text((old / "config.json").read_text().replace(MADE_IN, str(home)))
    words[words.index("--steps") + 1] = "3"
    assert nerf(*words) == 0
    assert checkpoint.spent(old).step == 3


def test_a_study_finds_its_old_run_done(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    then = json.loads((home / "study" / STUDIED / "metrics.json").read_text())
    grid = ["--field", "ngp", "--loss", "kl", "--views", 2, "--keep", 0.9, "--steps", 2, "--out", "study"]
    assert nerf("study", "street", "--priors", f"maps/{DRIVE}/{LIDAR}", *grid) == 0
    assert f"{STUDIED}: done before" in capsys.readouterr().err
    assert json.loads((home / "study" / STUDIED / "metrics.json").read_text()) == then


def test_the_installed_command_renders_a_stopped_run(home: Path) -> None:
    command = [BIN / "nerf", "render", "fits/stopped", "--frames", "3:4"]
    subprocess.run(command, capture_output=True, text=True, check=True)
    depth_m = codecs.read_depth_png(home / "fits" / "stopped" / "views" / "depth" / "0000000003.png")
    assert depth_m.shape == (32, 96)
    assert (depth_m > 0).any()


def test_a_stopped_run_goes_on_to_where_it_would_have_come(home: Path) -> None:
    folders = {name: home / "fits" / name for name in ("stopped", "finished")}
    run = claim(folders["stopped"], open_run(folders["finished"]).config)
    assert checkpoint.spent(run.folder).step == 3
    run.fit("cpu")
    assert checkpoint.spent(run.folder).step == 6
    now, then = load_file(run.folder / checkpoint.NAME), load_file(folders["finished"] / "field.safetensors")
    stopped = load_file(unpacked(home))
    del then["model.field.grid"]  # on CPUs without matrix tiles, as that one, its gradient was wrong then
    for name, tensor in then.items():
        far, moved = (now[name] - tensor).norm(), (stopped[name] - tensor).norm()
        assert far < 0.25 * moved, f"{name}: {far:.2g} away, three steps moved it by {moved:.2g}"
    shutil.copyfile(run.folder / checkpoint.NAME, folders["finished"] / checkpoint.NAME)
    reported = figures(folders["finished"])
    assert nerf("eval", folders["finished"], folders["stopped"]) == 0
    for folder in folders.values():
        assert figures(folder) == pytest.approx(reported, rel=0.01)


def unpacked(home: Path) -> Path:
    """The checkpoint of the stopped run as it was, in a file of its own."""
    path = home / "then.safetensors"
    path.write_bytes(lzma.decompress((DATA / "fits" / "stopped" / "checkpoint.safetensors.xz").read_bytes()))
    return path


def figures(run: Path) -> list[float]:
    metrics = Report.load(run / "metrics.json").metrics()
    return [metrics[name] for name in ("psnr", "ssim_uniform7", "rmse", "abs_rel")]
