"""The commands on a field of Gaussians: from fit to export, and what they say of flags that it does not read."""

import shutil
from pathlib import Path

import pytest
from test_nerf_cli import SIZE, nerf, refused
from test_nerf_export import read_ply

from nerf import checkpoint
from nerf.report import Report
from nerf.run import open_run
from priors import build
from priors.drives import open_drive
from priors.methods.lidar import Lidar
from priors.street.write import write_street

pytestmark = pytest.mark.splats

FIT = ("--field", "splat", "--start-step", 6)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """street/, cache/ with a LiDAR prior, and runs/a: three steps of Gaussians."""
    folder = tmp_path_factory.mktemp("splats")
    write_street(folder / "street", 10, 7, SIZE)
    prior = build.prepare(open_drive(folder / "street"), Lidar(), folder=folder / "cache").run().prior
    words = ("--prior", prior.folder, "--views", 3, *FIT, "--steps", 3, "--run", folder / "runs" / "a")
    assert nerf("fit", folder / "street", *words) == 0
    return folder


def test_a_fit_is_scored_and_goes_on(home: Path) -> None:
    run = home / "runs" / "a"
    assert Report.load(run / "metrics.json").metrics()["psnr"] > 5
    assert open_run(run).config.fit.model.gaussians.start_step == 6
    copy = home / "runs" / "b"
    shutil.copytree(run, copy)
    prior = open_run(run).config.prior
    assert nerf("fit", home / "street", "--prior", prior, "--views", 3, *FIT, "--steps", 5, "--run", copy) == 0
    assert checkpoint.spent(copy).step == 5


def test_what_other_fields_write_is_written_of_gaussians(home: Path) -> None:
    run = home / "runs" / "a"
    assert nerf("render", run, "--frames", "0:2", "--out", home / "views") == 0
    assert len(list((home / "views").rglob("*.png"))) == 6
    assert nerf("video", run, "--frames", "0:2", "--out", home / "a.mp4") == 0
    loose = ("--opacity", 0.0, "--agreement", 1e9, "--farthest-m", 1e9)
    assert nerf("export", run, "--frames", "0:2", *loose) == 0
    assert len(read_ply(run / "cloud.ply")) > 100
    assert nerf("eval", run) == 0
    assert nerf("export", run, "--kind", "splats") == 0
    assert {"f_dc_0", "f_rest_44", "opacity", "scale_2", "rot_3"} <= set(read_ply(run / "splats.ply").dtype.names)


def test_flags_that_the_field_does_not_read_are_refused(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    street = home / "street"
    assert "--width 32: --field splat does not read it" in refused(capsys, "fit", street, *FIT, "--width", 32)
    assert "--no-carve: --field splat" in refused(capsys, "fit", street, *FIT, "--no-carve")
    told = refused(capsys, "fit", street, "--field", "ngp", "--most-gaussians", 1000)
    assert "--most-gaussians 1000: --field ngp does not read it: leave it out" in told
    assert "--degree 7: expected" in refused(capsys, "fit", street, "--field", "splat", "--degree", 7)


def test_another_field_has_none_to_export(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert nerf("fit", home / "street", "--views", 3, "--field", "ngp", "--steps", 1, "--run", home / "runs" / "n") == 0
    assert "has no Gaussians: fit one with --field splat" in refused(
        capsys, "export", home / "runs" / "n", "--kind", "splats"
    )
