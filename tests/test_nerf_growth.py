"""`nerf bench --sweep`: the points of each axis, a step measured, and the command's table."""

from dataclasses import replace
from pathlib import Path

import pytest

from cli.nerf import PROGRAM
from nerf.bench import growth
from nerf.bench.growth import AXES, Answer, Errand, points, run, sweep
from nerf.config import FitConfig
from nerf.study import NONE, FitRunner, RunSpec
from priors.drives import open_drive
from priors.errors import DataError

pytestmark = pytest.mark.stress
SPEC = RunSpec("ngp", "dense", NONE)


def test_each_axis_changes_its_own_work_and_nothing_else() -> None:
    fit = FitConfig()
    assert [(x, own.rays) for x, _, own in points("rays", SPEC, fit)][-1] == (4096, 4096)
    assert [own.model.log2_size for _, _, own in points("table", SPEC, fit)] == list(growth.LOG2_ROWS)
    assert [own.views for _, own, _ in points("frames", SPEC, fit)] == list(growth.VIEWS)
    counts = [own.model.sampler for _, _, own in points("samples", SPEC, fit)]
    assert [(each.count, each.proposed) for each in counts] == [(n, n) for n in growth.SAMPLES]
    for axis in AXES:
        for _, _, own in points(axis, SPEC, fit):
            usual = replace(own.model, sampler=fit.model.sampler, log2_size=fit.model.log2_size)
            assert replace(own, model=usual, rays=fit.rays) == replace(fit, rays_growth=1.0)


def test_a_fit_is_measured(street: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growth, "COLD", 1)
    monkeypatch.setattr(growth, "STEPS", 3)
    drive = open_drive(street)
    described = {"name": drive.name, **drive.describe()}
    answer = run(Errand(described, SPEC, FitConfig(rays=64), None, 1))
    assert not answer.error and answer.processor_s > 0 and answer.peak_gib > 0
    assert answer.views == len(drive)
    lost = run(Errand(described, replace(SPEC, prior="nowhere"), FitConfig(rays=64), None, 1))
    assert "nowhere" in lost.error


def test_slopes_and_failures(street: Path, tmp_path: Path) -> None:
    runner = FitRunner(open_drive(street), FitConfig())

    def ask(errand: Errand) -> Answer:
        if errand.spec.field == "nerfpp":
            return Answer(error="too narrow")
        return Answer(1e-5 * errand.fit.rays, 0.5, 4)

    told: list[str] = []
    grown = sweep("rays", runner, [SPEC, replace(SPEC, field="nerfpp")], told.append, ask)
    assert len(told) == 2 * len(growth.RAYS)
    assert grown[0].slope(lambda found: found.processor_s) == pytest.approx(1)
    assert grown[1].error == "too narrow" and not grown[1].points
    with pytest.raises(DataError, match="--sweep rays: too narrow"):
        sweep("rays", runner, [replace(SPEC, field="nerfpp")], ask=ask)


def test_the_command(
    street: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(growth, "send", lambda errand: Answer(1e-3 * errand.fit.rays, 0.5, 4))
    words = ["bench", str(street), "--field", "ngp", "--sweep", "rays", "--out", str(tmp_path / "bench")]
    assert PROGRAM.run(words) == 0
    assert "1.00" in capsys.readouterr().out and (tmp_path / "bench" / "sweep-rays.svg").is_file()
    assert PROGRAM.run([*words, "--ablate"]) == 2
    assert "--sweep rays: scores no views: leave out --ablate" in capsys.readouterr().err
    assert PROGRAM.run([*words[:2], "--field", "warp", "--priors", "truth", "--sweep", "rays"]) == 2
    assert "no field here is trained: name one by --field" in capsys.readouterr().err
