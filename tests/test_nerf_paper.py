"""The study as one grid and one page: which runs it has, and what its page says of figures that are known."""

import re
from pathlib import Path

import numpy as np
import pytest
from test_nerf_study import Runner, made

from nerf.paper import numbers, page
from nerf.paper.findings import judge
from nerf.paper.measured import Measured
from nerf.paper.numbers import FEW, MONO, NONE, STEREO, TABLE_3, TABLE_6, TRUTH
from nerf.paper.plan import Plan, role_of
from nerf.study import Outcome, RunSpec, left_of
from priors import cache
from priors.errors import UsageError

METHODS = ("lidar", "completion", "stereo", "mono")
SETTINGS = {"drive": {"path": "/data/wall", "dataset": "kitti_raw"}, "frames": None, "steps": 1500}


@pytest.fixture
def priors(tmp_path: Path) -> tuple[str, ...]:
    """None, and a prior of each method."""
    folders = []
    for number, method in enumerate(METHODS):
        folder = tmp_path / "cache" / "wall" / f"{method}-{number:010d}"
        manifest = {"format": cache.FORMAT, "key": f"{number:010d}", "method": method}
        cache.create(folder, {**manifest, "drive": {"name": "wall", "path": "/data/wall"}})
        folders.append(str(folder))
    return (NONE, *folders)


def as_the_study_has_it(spec: RunSpec) -> tuple[float, float]:
    """PSNR and AbsRel of a run as the study prints or describes them, so that every finding holds."""
    role = role_of(spec.prior)
    row = TABLE_3.get((spec.field, role, spec.views))
    psnr, abs_rel = (row.psnr, row.abs_rel) if row else (FEW.get((spec.views, role), (15.0, 0))[0], 0.06)
    mono = TABLE_6["mono"].psnr
    psnr += {"l1": TABLE_6["mono, l1"].psnr - mono, "kl": TABLE_6["mono, kl"].psnr - mono}.get(spec.loss or "", 0)
    psnr += {40.0: TABLE_6["mono, clip 40"].psnr - mono, 80.0: TABLE_6["mono, clip 80"].psnr - mono}.get(spec.clip, 0)
    psnr -= 0.86 * spec.truth_mask + (0 if spec.density is None else 0.5 * (1 - spec.density))
    return psnr, abs_rel


def contrary(spec: RunSpec) -> tuple[float, float]:
    """Figures under which nothing that the study found holds: priors harm, but for filters, losses and masks."""
    psnr, abs_rel = as_the_study_has_it(spec)
    truth = role_of(spec.prior) == TRUTH
    loss = {"l1": -2, "kl": 3}.get(spec.loss or "", 0) + 2 * (spec.clip is not None) - 2 * (spec.confidence is not None)
    loss += 3 * (spec.density is not None) + 2 * spec.truth_mask - 3 * (role_of(spec.prior) == MONO)
    if spec.prior == NONE:
        return 25.0, 0.5
    return 21.0 + loss - psnr / 1e6, 0.6 + abs_rel + 0.4 * (not truth)


class Known(Runner):
    """Makes reports of known figures."""

    def __init__(self, figures, **more) -> None:
        super().__init__(**more)
        self.figures = figures

    def quality(self, spec: RunSpec) -> tuple[float, float]:
        return self.figures(spec)


def measured(plan: Plan, folder: Path, figures=as_the_study_has_it, **more) -> Measured:
    return Measured(plan, made(plan, folder, Known(figures, **more), SETTINGS))


def test_the_plan_is_table_3_few_views_ablations_and_the_density_curve(priors: tuple[str, ...]) -> None:
    plan = Plan(priors)
    runs = plan.runs()
    assert len(runs) == len({spec.name for spec in runs}) == 3 * 5 * 2 * 3 + 2 * 3 + 7 + 3 * 5 * 2 - 3 + 1
    assert {(spec.field, spec.views) for spec in runs if spec.loss in ("l1", "kl", "urf")} == {("mip360", "sparse")}
    assert [spec.seed for spec in runs] == sorted(spec.seed for spec in runs), "a part of it is whole tables of a seed"
    assert all(spec.views == "sparse" for spec in runs[:15])
    assert {spec.views for spec in runs} == {"dense", "sparse", "1/8", "1/16"}
    assert sum(spec.over_all for spec in runs) == 3 * 5 + 1
    assert role_of(plan.prior(TRUTH) or "") == TRUTH, "accumulated LiDAR is the study's true depth"
    assert Plan((NONE, "truth", *priors[1:])).prior(TRUTH) == "truth"


def test_a_plan_has_what_drive_and_priors_allow(priors: tuple[str, ...]) -> None:
    assert not any(spec.truth_mask for spec in Plan(priors, has_truth=False).runs())
    few = Plan((NONE, priors[3]), ("ngp",), (7,), few=("1/8",)).runs()
    assert [spec.name.replace(Path(priors[3]).name, "stereo") for spec in few] == [
        "ngp-sparse-none-seed7", "ngp-sparse-stereo-mse-seed7", "ngp-dense-none-seed7", "ngp-dense-stereo-mse-seed7",
        "ngp-1of8-none-seed7", "ngp-1of8-stereo-mse-seed7",
    ]  # fmt: skip
    for lacking in ((NONE,), priors[1:]):
        with pytest.raises(UsageError, match="compares priors with colours alone"):
            Plan(lacking)


def test_what_the_study_printed_reproduces_the_study(priors: tuple[str, ...], tmp_path: Path) -> None:
    found = judge(measured(Plan(priors, seeds=(0,)), tmp_path))
    assert [(each.verdict, each.says) for each in found if each.verdict != "reproduces"] == []
    assert len(found) == 10 and not any(each.why for each in found)


def test_the_opposite_does_not(priors: tuple[str, ...], tmp_path: Path) -> None:
    found = judge(measured(Plan(priors, seeds=(0,)), tmp_path, contrary))
    assert [(each.verdict, each.says) for each in found if each.verdict != "does not"] == []
    assert "(!)" in found[0].measured and "by colours alone is" in found[0].why
    assert "is off: the fields that lean on it have an AbsRel of 1." in found[1].why
    assert "stereo is off" in found[0].why and "stereo" not in found[1].why
    assert all("mono is off" in found[number].why for number in (2, 3, 4, 5))
    assert found[4].why.startswith("with this mean a sparse map pulls as hard")


def test_a_page_has_both_numbers_in_every_cell(priors: tuple[str, ...], tmp_path: Path) -> None:
    written = page.page(measured(Plan(priors, seeds=(0,)), tmp_path), "nerf study DATA --preset paper")
    row = next(line for line in written.splitlines() if line.startswith("| Instant-NGP | Mono Depth |"))
    cells = [cell.strip() for cell in row.split("|")[3:-1]]
    assert (cells[0], cells[5]) == ("20.59 / 20.59", "18.17 / 18.17")
    assert cells[1] == "0.700 / 0.617", "Instant-NGP's SSIM is the Gaussian one"
    assert cells[2] == "- / 0.483" and cells[9].endswith(" / 0.096") and cells[10] == "-"
    assert "    nerf study DATA --preset paper\n" in written and "Drive wall; 2 held-out views" in written
    assert "1500 steps a run" in written and "GT Depth: lidar, Depth Completion: completion" in written
    assert written.count("**Reproduces**") == 10
    assert "no Argoverse log was at hand" in written


def test_an_argoverse_log_is_compared_with_table_5(priors: tuple[str, ...], tmp_path: Path) -> None:
    plan = Plan((NONE, priors[1]), ("ngp",), (0,), few=())
    outcomes = made(plan, tmp_path, Known(as_the_study_has_it), {**SETTINGS, "drive": {"dataset": "argoverse1"}})
    written = page.page(Measured(plan, outcomes), "nerf study")
    assert "| Instant-NGP | RGB-Only | 20.51 / 28.07 |" in written and "no Argoverse log" not in written


def test_what_was_not_run_is_listed_and_judged_as_that(priors: tuple[str, ...], tmp_path: Path) -> None:
    plan = Plan((NONE, priors[4]), ("mip360",), (0,), has_truth=False)
    with pytest.raises(KeyboardInterrupt):
        made(plan, tmp_path, Known(as_the_study_has_it, stop_at=3), SETTINGS)
    done = [spec for spec in plan.runs() if spec not in left_of(plan, tmp_path, SETTINGS)]
    assert len(done) == 3
    part = Measured(plan, made_only(plan, tmp_path, done))
    written = page.page(part, "nerf study")
    assert f"3 of {len(plan.runs())} runs have figures" in written
    assert "- Stereo Depth: no such prior was named." in written and "- GT masking: the drive has no true" in written
    assert "- Table 3, MipNeRF-360, dense, seed 0: 1 run not made yet." in written
    assert sum(int(count) for count in re.findall(r": (\d+) runs? not made yet", written)) == len(plan.runs()) - 3
    assert "**Not run**" in written
    assert part.figure(part.spec(STEREO), "psnr") is None
    failed = [Outcome(spec, None, "no map") for spec in plan.runs()]
    assert page.page(Measured(plan, failed), "nerf study").count("`: no map") == len(failed)


def made_only(plan: Plan, folder: Path, specs: list[RunSpec]) -> list[Outcome]:
    """The outcomes of runs that are done."""

    class Some:
        def runs(self) -> list[RunSpec]:
            return specs

    return made(Some(), folder, Known(as_the_study_has_it), SETTINGS)


def test_seeds_are_averaged_with_their_spread(priors: tuple[str, ...], tmp_path: Path) -> None:
    plan = Plan((NONE, priors[4]), ("ngp",), (0, 1, 2), few=())
    known = measured(plan, tmp_path, lambda spec: (20.0 + spec.seed, 0.1))
    spec = known.spec(MONO, "ngp")
    assert spec is not None and known.figure(spec, "psnr") == pytest.approx(21.0)
    assert known.spread_db(spec) == pytest.approx(np.std([20, 21, 22], ddof=1))
    assert "| 1.00 |" in page.page(known, "nerf study")


def test_the_study_s_numbers_keep_its_own_gains() -> None:
    gains = [TABLE_3[field, MONO, "sparse"].psnr - TABLE_3[field, NONE, "sparse"].psnr for field in numbers.FIELDS]
    assert gains == pytest.approx([2.42, 1.14, 2.73]), "the study's text: 14 %, and its table"
    assert len(TABLE_3) == 30 and len(numbers.TABLE_5) == 16
