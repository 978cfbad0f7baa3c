"""`nerf stress --fits`: what is stated of each fit is judged, and the fits themselves are as stated (slow)."""

import json
import math
from pathlib import Path

import numpy as np
import pytest

from cli.nerf import PROGRAM
from nerf.finite import NotFiniteError
from nerf.stress import fit_page, fit_scene, fits, spoilt
from nerf.stress.fits import ALIKE, FEWER, FINITE, RIGHT, Case, Row

pytestmark = pytest.mark.stress


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> tuple[fit_scene.Scene, fit_scene.Truths]:
    folder = tmp_path_factory.mktemp("fits")
    fit_scene.write_street(folder / "street", 10, 11, (48, 156))
    return fit_scene.opened(folder / "street", None, folder)


def test_what_is_spoilt(opened: tuple[fit_scene.Scene, fit_scene.Truths]) -> None:
    scene, _ = opened
    right = spoilt.depths(scene)
    assert np.array_equal(spoilt.depths(spoilt.scaled(2)(scene)), 2 * right)
    for spoil in (spoilt.at_random, spoilt.in_blobs):
        changed = (spoilt.depths(spoil(scene)) != right)[right > 0]
        assert changed.mean() == pytest.approx(0.3, abs=0.08)
    black = spoilt.with_a_black_frame(scene)
    assert sum(not black.images[position].any() for position in scene.train) == 1
    assert np.array_equal(spoilt.depths(black), right)
    assert len(spoilt.without_a_frame(scene).train) == len(scene.train) - 1


OTHER = Row("right prior", 20.0, 0.05, "")


@pytest.mark.parametrize(
    ("found", "stated", "fault"),
    [
        ((19.1, 0.06), ALIKE, ""),
        ((18.9, 0.05), ALIKE, "1.10 dB lost"),
        ((20.0, 0.08), ALIKE, "AbsRel 0.0800, more than 0.0650"),
        ((math.nan, 0.05), ALIKE, "numbers that are not finite"),
        ((math.inf, 0.05), FINITE, "numbers that are not finite"),
        ((8.0, 3.0), FINITE, ""),
        ("the loss is not finite at step 3", FINITE, ""),
        ("the loss is not finite at step 3", ALIKE, "refused"),
    ],
)
def test_a_fit_is_judged_by_what_is_stated(found: tuple[float, float] | str, stated: str, fault: str) -> None:
    assert fits._row(Case("any", stated), OTHER if stated == ALIKE else None, found).fault == fault


def test_a_refusal_is_a_row(
    opened: tuple[fit_scene.Scene, fit_scene.Truths],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fitted(scene: object, truths: object, config: fits.FitConfig) -> tuple[float, float]:
        if config.seed == 4:
            raise NotFiniteError("the loss is not finite at step 3")
        return (19.0 if config.optimiser.grid > 0.05 else 20.0), 0.05

    monkeypatch.setattr(fits, "fitted", fitted)
    rows = fits.run(*opened, fits.config_of("ngp", 5))
    assert [row.case for row in rows] == [case.name for case in fits.CASES] and not any(row.fault for row in rows)
    assert [row.told for row in rows if row.told] == ["the loss is not finite at step 3"]
    assert json.loads(json.dumps([row.record() for row in rows], allow_nan=False))[-6]["psnr"] is None
    assert "17 fits, 0 not as stated" in fit_page.text(rows)
    assert fit_page.markdown(rows, "nerf stress --fits\n\na street").count("| as stated |") == 14
    only = fits.run(*opened, fits.config_of("ngp", 5), [fits.CASES[1]])
    assert [row.case for row in only] == [RIGHT.name, fits.CASES[1].name]
    black = next(case for case in fits.CASES if "black" in case.name)
    assert [row.case for row in fits.run(*opened, fits.config_of("ngp", 5), [black])] == [FEWER.name, black.name]


def test_wrong_flags_are_one_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for words, told in (
        (["--fits", "--modes"], "--modes: of the routines: leave out --modes or --fits"),
        (["--steps", "5"], "--steps: read with --fits: add it, or leave --steps out"),
        (["--fits", "--prior", "cache"], "--prior cache: name its drive by --data"),
    ):
        assert PROGRAM.run(["stress", *words]) == 2
        assert told in capsys.readouterr().err


@pytest.mark.slow
def test_the_fits_are_as_stated(tmp_path: Path) -> None:
    """All of them on the street: what the command does."""
    scene, truths = fit_scene.opened(None, None, tmp_path)
    rows = fits.run(scene, truths, fits.config_of("mip360", 200))
    assert [f"{row.case}: {row.fault}" for row in rows if row.fault] == []
