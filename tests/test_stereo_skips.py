"""What stereo leaves out changes little of its depth: rows of sky, disparities that no surface reaches."""

from pathlib import Path

import numpy as np
import pytest

from priors.drives import open_drive
from priors.methods import stereo
from priors.methods.stereo import Stereo
from priors.sky import sky_mask
from priors.types import Depth, FloatMap, Frame, Image, Mask

pytestmark = pytest.mark.stress
DIFFERS = 0.01
"""Share of the depth from which on a pixel counts as another one."""
TOLERATED = 0.12
"""Share of the ground that may differ: 5 % did on drive 0009 (tests/bench/bench_stereo_skips.py), before a choice among
surfaces followed what was matched."""
WORSE = 1.02
"""How many times the error of the whole search that of the short one may be."""


def whole(method: Stereo, frame: Frame, monkeypatch: pytest.MonkeyPatch) -> Depth:
    """The map when nothing is left out: every row, and disparities up to half of the width."""
    with monkeypatch.context() as patched:
        patched.setattr(stereo, "rows_below", lambda sky: slice(0, sky.shape[0]))
        patched.setattr(stereo, "find_range", lambda frame, pair: frame.camera.size[1] // 2)
        return method(frame)


def test_what_is_left_out_changes_little_and_costs_no_accuracy(street: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    method, drive = Stereo(offset_px=(0.0,)), open_drive(street)
    differs, errors = [], []
    for frame in (drive[index] for index in (0, 3)):
        short, long, truth = method(frame), whole(method, frame, monkeypatch), frame.truth()
        ground = ~sky_mask(frame.image())
        differs.append(np.mean(np.abs(short.depth_m / long.depth_m - 1)[ground] > DIFFERS))
        near = ground & truth.valid & (truth.depth_m < 40)
        errors.append([np.mean(np.abs(d.depth_m - truth.depth_m)[near] / truth.depth_m[near]) for d in (short, long)])
    assert np.mean(differs) < TOLERATED
    short_error, long_error = np.mean(errors, axis=0)
    assert short_error < WORSE * long_error


def test_rows_of_sky_alone_are_not_matched(street: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frame, rows = open_drive(street)[0], []
    estimate = stereo.classical.estimate

    def watched(left: Image, right: Image, most_px: int, sky: Mask) -> tuple[FloatMap, FloatMap]:
        rows.append(left.shape[0])
        return estimate(left, right, most_px, sky)

    monkeypatch.setattr(stereo.classical, "estimate", watched)
    monkeypatch.setattr(stereo, "sky_mask", lambda image: np.indices(image.shape[:2])[0] < 30)
    Stereo(offset_px=(0.0,))(frame)
    assert rows == [frame.camera.size[0] - 30 + 16]  # a margin of 16 rows is kept
