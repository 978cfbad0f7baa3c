"""A pair whose rows do not match is measured, told and put right; a search goes a little beyond; auto suits the CPU."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from factories import write_raw
from standin import install
from test_stereo import frame, scene

from cli.priors import PROGRAM
from priors import codecs, keys
from priors.drives import open_drive
from priors.errors import UsageError
from priors.machine import cpu
from priors.methods import _stereo_choice
from priors.methods.stereo import Stereo
from priors.nets import runtime, speeds, weights
from priors.pairs.read import Pair
from priors.pairs.rows import measure_rows, raise_rows
from priors.records import record

pytestmark = pytest.mark.networks
ZERO = (0.0, 0.0, 0.0)


def textured(rows_px: float = 0.0) -> Pair:
    """A pair at 12 px, its right image rows_px too low: waves between the pixels, and noise for corners."""
    rng = np.random.default_rng(2)
    wide = np.kron(rng.integers(40, 220, (60, 130)), np.ones((4, 4))).astype(np.uint8)
    left, right = wide[:200, :400], wide[:200, 12:412]
    return Pair(np.ascontiguousarray(left), raise_rows(np.ascontiguousarray(right), -rows_px), mirrored=False)


@pytest.mark.parametrize("rows_px", [-7.0, -2.5, 1.0, 3.3, 9.0])
def test_an_offset_of_rows_is_found_and_taken_back(rows_px: float) -> None:
    pair, plain = textured(rows_px), textured()
    found = measure_rows(pair)
    assert found == pytest.approx(rows_px, abs=0.15)
    inside = slice(12, -12)
    raised = raise_rows(pair.right, found or 0.0)
    before = np.abs(pair.right.astype(int) - plain.right)[inside].mean()
    assert np.abs(raised.astype(int) - plain.right)[inside].mean() < 0.35 * before


def test_whole_rows_are_moved_exactly() -> None:
    image = np.random.default_rng(0).integers(0, 256, (30, 20, 3), dtype=np.uint8)
    assert np.array_equal(raise_rows(image, 2.0)[:-2], image[2:])
    assert np.array_equal(raise_rows(image, -2.0)[2:], image[:-2])
    assert np.array_equal(raise_rows(image, 2.0)[-1], image[-1])
    assert np.array_equal(raise_rows(image, 0.0), image)


@pytest.mark.parametrize("kind", ["as it should be", "half a row", "blank", "two moments", "tiny"])
def test_what_is_no_offset_is_none(kind: str) -> None:
    pair = textured(0.5 if kind == "half a row" else 0.0)
    if kind == "blank":
        pair = replace(pair, right=np.full_like(pair.right, 90))
    if kind == "two moments":
        parts = np.array_split(pair.right, 4, axis=1)
        pair = replace(pair, right=np.hstack([raise_rows(p, o) for p, o in zip(parts, (-8, -3, 3, 8), strict=True)]))
    if kind == "tiny":
        pair = Pair(pair.left[:3, :5], pair.right[:3, :5], mirrored=False)
    assert measure_rows(pair) is None


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_map_is_that_of_the_rectified_pair(side: Any) -> None:
    pair, off = textured(), textured(4.0)
    views = {"left": (pair.left, pair.right), "right": (pair.right, pair.left)}[side]
    wrong = {"left": (off.left, off.right), "right": (off.right, off.left)}[side]
    sign = 1 if side == "left" else -1  # the other image lies too high as the right one sees it
    right = Stereo(offset_px=ZERO).resolve(frame(*views, side=side))
    method = Stereo(offset_px=ZERO).resolve(frame(*wrong, side=side))
    assert right.rows_px is None
    assert method.rows_px == pytest.approx(4.0 * sign, abs=0.15)
    expected, found = right(frame(*views, side=side)).depth_m, method(frame(*wrong, side=side)).depth_m
    inside = np.s_[16:-16, 40:-40]
    assert np.mean(np.abs(found / expected - 1)[inside] < 0.05) > 0.95
    left_alone = replace(method, rows_px=0.0)(frame(*wrong, side=side)).depth_m
    assert np.mean(np.abs(left_alone / expected - 1)[inside] < 0.05) < 0.7


def test_build_tells_it_and_the_key_of_a_good_pair_stays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = write_raw(tmp_path)
    config = record(Stereo(offset_px=ZERO).resolve(open_drive(folder)[0]))
    assert config["rows_px"] is None
    manifest = dict.fromkeys(keys.DECIDES, "") | {"config": config}
    old = {name: value for name, value in config.items() if name not in ("rows_px", "resize")}
    assert keys.key(manifest, Stereo) == keys.key_of(manifest | {"config": old})
    off = textured(3.0)
    for name, image in (("left", off.left), ("right", off.right)):
        codecs.write_image(tmp_path / "mine" / name / "a.png", image)
    intrinsics = {"fx": 300.0, "fy": 300.0, "cx": 199.5, "cy": 99.5, "baseline_m": 0.5}
    (tmp_path / "mine" / "calib.json").write_text(json.dumps(intrinsics))
    folder = tmp_path / "mine"
    flags = ["--method", "stereo", "--cache", str(tmp_path / "cache")]
    assert PROGRAM.run(["build", str(folder), *flags]) == 0
    told = capsys.readouterr().err
    assert "the other image lies 3.0 rows too low: it is shifted back" in told
    assert PROGRAM.run(["build", str(folder), *flags, "--stereo.rows-px", "0"]) == 0
    assert "too low" not in capsys.readouterr().err


@pytest.mark.parametrize(
    "flags", [["--stereo.rows-px", "500"], ["--stereo.rows-px", "nan"], ["--stereo.headroom", "0.5"]]
)
def test_numbers_out_of_range_are_refused(flags: list[str], tmp_path: Path) -> None:
    assert PROGRAM.run(["build", str(write_raw(tmp_path)), "--method", "stereo", *flags]) == 2


def test_networks_search_as_far_as_their_header_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = install(monkeypatch, tmp_path / "weights", size="s")
    left, right, _ = scene()
    here = frame(left, right)
    asked = []
    for headroom in (None, 1.0, 4.0):
        if headroom is not None:
            weights.rewrite_about(file, headroom=headroom)
        method = Stereo(model="cfnet", runtime="fp32", resize="none", offset_px=ZERO)
        method(here)
        net: Any = runtime.open_net("cfnet", "s", "fp32").net
        asked.append(net.asked[-1])
        replace(method, max_disparity_px=40)(here)
        assert net.asked[-1] == 64  # what a user asks for is searched, and no more
    assert asked[0] == asked[1] < asked[2]  # weights of before are run as they were


@pytest.mark.parametrize("mode", ["amx", "avx512_bf16", "avx512", "avx2", "plain", "amx_emulated"])
def test_auto_keeps_to_what_the_table_says(mode: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cpu, "mode", lambda: mode)
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    slow = {"avx2": 7.07, "plain": 26.58}
    for size, known in (("s", {"amx", "avx512_bf16"}), ("l", {"amx"})):
        found = _stereo_choice.choose(size)
        assert found == "cfnet" if mode in known else found in ("classical", "cfnet")
    assert mode not in slow or _stereo_choice.choose() == "classical"
    monkeypatch.setattr(speeds, "times", lambda *_args, **_more: 99.0)
    assert _stereo_choice.choose() == "classical"
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    assert _stereo_choice.choose() == "cfnet"


def test_auto_is_recorded_as_what_it_chose(monkeypatch: pytest.MonkeyPatch) -> None:
    left, right, _ = scene()
    for chosen in ("classical", "cfnet"):
        monkeypatch.setattr(_stereo_choice, "choose", lambda size, chosen=chosen: chosen)
        auto, named = Stereo(model="auto", runtime="fp32"), Stereo(model=chosen, runtime="fp32")  # type: ignore[arg-type]
        if chosen == "classical":
            assert auto.resolve(frame(left, right)) == named.resolve(frame(left, right))
        assert auto.reads == named.reads and auto.sure_within == named.sure_within and auto.unread() == named.unread()
        assert auto.weights_digest() == named.weights_digest()
    with pytest.raises(UsageError, match="which network is it of"):
        Stereo(model="auto", weights=Path("mine.safetensors"))
