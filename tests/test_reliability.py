"""Reliability: the diagram against a slow twin, and `priors eval --reliability` and --held-back as installed."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from installed import fail, succeed

from eval.calibration import Tolerance, calibration_error
from eval.protocol import preset
from eval.reliability import BINS, LEAST_SHARE, reliability
from priors import build
from priors.drives import open_drive
from priors.methods.stereo import Stereo
from priors.reliability import readings, reliabilities
from priors.score import pair
from priors.selection import Selection

FIVE = Tolerance(0.05, "share")


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=60))
@settings(deadline=None)
def test_each_bin_is_what_a_loop_finds(values: list[tuple[float, bool]]) -> None:
    confidence, right = np.array([v for v, _ in values]), np.array([r for _, r in values])
    found = reliability(confidence, right, FIVE)
    stated = [(c, r) for c, r in values if c > 0]
    for number in range(BINS):
        inside = [(c, r) for c, r in stated if min(int(c * BINS), BINS - 1) == number]
        assert found.share[number] == pytest.approx(len(inside) / max(len(stated), 1))
        if inside and len(inside) / len(stated) >= LEAST_SHARE:
            assert found.stated[number] == pytest.approx(sum(c for c, _ in inside) / len(inside))
            assert found.right[number] == pytest.approx(sum(r for _, r in inside) / len(inside))
        else:
            assert np.isnan(found.right[number])
    if stated:
        assert found.says == pytest.approx(np.mean([c for c, _ in stated]))
        assert found.is_right == pytest.approx(np.mean([r for _, r in stated]))
        assert found.error == pytest.approx(calibration_error(confidence[confidence > 0], right[confidence > 0]))


def test_both_readings_of_a_prior(street: Path, tmp_path: Path) -> None:
    drive = open_drive(street)
    job = build.prepare(drive, Stereo(), folder=tmp_path)
    prior = job.run(job.plan(Selection(frames="0:1"))).prior
    assert [str(reading.within) for reading in readings(prior)] == ["1 m", "5 %"]
    made = reliabilities(pair(prior, drive), preset("uncapped"))
    depth, truth_m = prior.read(drive.ids[0]), drive[0].truth().depth_m
    for one, chance in zip(made, (depth.confidence, depth.within_5_percent), strict=True):
        assert chance is not None
        known = depth.valid & (truth_m > 0) & (chance > 0)
        right = one.within.within(depth.depth_m[known], truth_m[known])
        assert one.says == pytest.approx(chance[known].mean(), abs=0.01)
        assert one.is_right == pytest.approx(right.mean(), abs=0.01)


@pytest.mark.slow
def test_the_command_draws_it(street: Path, tmp_path: Path) -> None:
    succeed("build", street, "--method", "stereo", "--frames", "0:1", cwd=tmp_path)
    told = succeed("eval", "--reliability", "reliability.png", cwd=tmp_path)
    assert "within 1 m it says 0." in told and "within 5 % it says 0." in told
    assert (tmp_path / "reliability.png").read_bytes().startswith(b"\x89PNG")
    assert "none of its frames is held back" in fail("eval", "--held-back", cwd=tmp_path)
