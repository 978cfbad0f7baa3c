"""The recipe "add a field family": the page's own code, in a temporary folder, through the public doors."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from nerf import checkpoint, fields
from nerf.config import FitConfig, ModelConfig
from nerf.fit import Status, fit
from nerf.run import begin, open_run
from priors import build, extensions
from priors.drives import open_drive
from priors.errors import DataError
from priors.methods.lidar import Lidar
from priors.street.write import write_street
from tests.test_nerf_fit import corridor
from tests.test_recipes import add, run, run_recipe

TITLE = "Add a field family"


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """street/, and mine/fields/ with the page's two families."""
    folder = tmp_path_factory.mktemp("home")
    write_street(folder / "street", 10, 7, (32, 96))
    add(TITLE, folder)
    return folder


@pytest.fixture
def families(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the folder one of the registry's, in this process."""
    monkeypatch.setattr(fields, "__path__", [*fields.__path__, str(home / "mine" / "fields")])
    for name in ("voxels", "wider"):
        monkeypatch.delitem(sys.modules, f"nerf.fields.{name}", raising=False)


def test_the_command_fits_and_scores_it(home: Path) -> None:
    (printed,) = run_recipe(TITLE, home)
    assert "PSNR" in printed
    (folder,) = home.glob("runs/*-voxels-dense")
    mine = {extensions.VARIABLE: "mine"}
    assert run(f"nerf render {folder} --frames 2:4 --out views", home, **mine).returncode == 0
    assert len(list((home / "views").rglob("*.png"))) == 6
    without = run(f"nerf eval {folder}", home)
    assert without.returncode == 1
    assert re.match(r"error: unknown field 'voxels': choose one of [\w, ]*\bngp\b[\w, ]*, or name the", without.stderr)


@pytest.mark.usefixtures("families")
def test_it_learns_leans_on_a_prior_and_is_opened_again(home: Path, tmp_path: Path) -> None:
    assert {"voxels", "wider"} <= set(fields.names())
    drive, seen = open_drive(home / "street"), list[Status]()
    prior = build.prepare(drive, Lidar(), folder=home / "cache").run().prior
    config = FitConfig(ModelConfig(family="voxels"), rays=512, steps=120)
    one_run = begin(drive, prior, fit=config, folder=tmp_path / "run")
    model = one_run.fit("cpu", seen.append)
    assert set(seen[-1].terms) == {"rgb", "depth"}
    assert float(seen[-1].loss) < 0.7 * float(seen[0].loss)
    assert one_run.report("cpu").metrics()["psnr"] > 12
    again = open_run(tmp_path / "run").open_model("cpu")
    pose, camera = one_run.scene.T_world_cam[9], one_run.scene.camera
    one, other = model.render(pose, camera), again.render(pose, camera)
    assert all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("rgb", "depth_m", "opacity"))


@pytest.mark.usefixtures("families")
@pytest.mark.parametrize("family", ["voxels", "wider"])
def test_it_resumes_bit_for_bit(tmp_path: Path, family: str) -> None:
    scene = corridor("sparse")
    model = ModelConfig(family=family, log2_size=12, finest=128, width=16)
    config = FitConfig(model, rays=256, steps=12)
    whole = fit(scene, config, tmp_path / "whole")

    def kill(status: Status) -> None:
        if status.step == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit(scene, config, tmp_path / "parts", kill)
    assert checkpoint.spent(tmp_path / "parts").step == 5
    parts = fit(scene, config, tmp_path / "parts").state()
    assert all(torch.equal(tensor, parts[name]) for name, tensor in whole.state().items())


@pytest.mark.usefixtures("families")
def test_another_familys_checkpoint_is_refused(tmp_path: Path) -> None:
    scene = corridor("sparse")
    fit(scene, FitConfig(ModelConfig(family="voxels"), rays=64, steps=1), tmp_path)
    small = ModelConfig(log2_size=12, finest=128, width=16)
    with pytest.raises(DataError, match=r"made with other settings \(expected field.grid"):
        fit(scene, FitConfig(small, rays=64, steps=2), tmp_path)


def test_a_file_without_a_family_is_told(tmp_path: Path) -> None:
    write_street(tmp_path / "street", 3, 7, (32, 96))
    (tmp_path / "mine" / "fields").mkdir(parents=True)
    (tmp_path / "mine" / "fields" / "odd.py").write_text("x = 1")
    done = run("nerf fit street --field odd --steps 1", tmp_path, **{extensions.VARIABLE: "mine"})
    assert done.returncode == 1
    (told,) = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert "odd.py: a field family's file needs FAMILY: see docs/architecture.md" in told
