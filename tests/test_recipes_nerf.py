"""The recipe "add a field family": the page's own code, in a temporary folder, through the public doors."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from nerf import checkpoint, fields
from nerf.config import FitConfig, ModelConfig
from nerf.fit import Status, fit
from nerf.run import begin, open_run
from priors import build
from priors.cache import Prior
from priors.drives import open_drive
from priors.errors import DataError
from priors.filters import Filters
from priors.methods.lidar import Lidar
from priors.street.write import write_street
from tests.test_nerf_fit import corridor

ROOT = Path(__file__).resolve().parents[1]
BLOCKS = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "recipes_family.md").read_text(), re.DOTALL)
SETTING, FAMILY, PROGRAM, SCRIPT = BLOCKS
STEPS = 120


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """street/, and my-families/ with the page's two families."""
    folder = tmp_path_factory.mktemp("home")
    write_street(folder / "street", 10, 7, (32, 96))
    (folder / "my-families").mkdir()
    (folder / "my-families" / "voxels.py").write_text(FAMILY)
    (folder / "my-families" / "wider.py").write_text(SETTING)
    return folder


@pytest.fixture
def families(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the folder one of the registry's, in this process."""
    monkeypatch.setattr(fields, "__path__", [*fields.__path__, str(home / "my-families")])
    for name in ("voxels", "wider"):
        monkeypatch.delitem(sys.modules, f"nerf.fields.{name}", raising=False)


def lidar(home: Path) -> Prior:
    drive = open_drive(home / "street")
    prior, method = build.prepare(drive, "lidar", Lidar(), Filters(), home / "cache")
    build.build(drive, prior, method, Filters(), build.plan(drive, prior, method.reads, build.Selection()))
    return prior


@pytest.mark.usefixtures("families")
def test_a_new_family_is_fitted_scored_opened_and_rendered(home: Path, tmp_path: Path) -> None:
    assert {"voxels", "wider"} <= set(fields.names())
    drive, seen = open_drive(home / "street"), list[Status]()
    config = FitConfig(ModelConfig(family="voxels"), rays=512, steps=STEPS)
    run = begin(drive, lidar(home), fit=config, folder=tmp_path / "run")
    model = run.fit("cpu", seen.append)
    assert set(seen[-1].terms) == {"rgb", "depth"}
    assert float(seen[-1].loss) < 0.7 * float(seen[0].loss)
    assert run.report("cpu").metrics()["psnr"] > 12
    again = open_run(tmp_path / "run").open_model("cpu")
    pose, camera = run.scene.T_world_cam[9], run.scene.camera
    one, other = model.render(pose, camera), again.render(pose, camera)
    assert all(np.array_equal(getattr(one, name), getattr(other, name)) for name in ("rgb", "depth_m", "opacity"))


@pytest.mark.usefixtures("families")
@pytest.mark.parametrize("family", ["voxels", "wider"])
def test_a_new_family_resumes_bit_for_bit(tmp_path: Path, family: str) -> None:
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


def test_an_unknown_family_is_refused_in_a_line(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such family: choose one of mip360, nerfpp, ngp"):
        fit(corridor(), FitConfig(ModelConfig(family="voxels"), steps=1), tmp_path)


NAMED = PROGRAM.split("from cli.nerf")[0]
"""Names the folder; without the command that follows it."""


@pytest.mark.parametrize(
    ("program", "arguments", "last"),
    [
        (PROGRAM, ["fit", "street", "--field", "voxels", "--steps", "5"], "wrote runs/"),
        (NAMED + SCRIPT, [], ""),
    ],
    ids=["command", "script"],
)
def test_the_pages_programs_run(home: Path, tmp_path: Path, program: str, arguments: list[str], last: str) -> None:
    for name in ("street", "my-families"):
        (tmp_path / name).symlink_to(home / name)
    (tmp_path / "program.py").write_text(program)
    command = [sys.executable, "program.py", *arguments]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith(last)
    [report] = tmp_path.glob("runs/*-voxels-dense/metrics.json")
    assert json.loads(report.read_text())["metrics"]["psnr"] > 5
