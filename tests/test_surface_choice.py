"""Choice of surfaces: what is offered, what comes out, the fit, and that a header keeps it."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from test_learn_completion import street  # noqa: F401
from torch import nn

from cli import priors
from priors.errors import DataError
from priors.learn import surface_fit
from priors.learn.surface_fit import UnsurePixels
from priors.methods import _stereo_classical as classical
from priors.nets import runtime, surface_choice, weights
from priors.nets.surface_choice import (
    CLUES,
    FARTHEST,
    FIRST_CLUES,
    HIDDEN,
    NEAREST,
    OFFERED,
    UNSURE,
    WIDE_CLUES,
    WIDE_OFFERED,
    SurfaceChoice,
)
from priors.types import FloatMap, Image, Mask

SIZES = st.tuples(st.integers(1, 12), st.integers(1, 14))


def some_maps(size: tuple[int, int], seed: int) -> tuple[FloatMap, FloatMap, FloatMap, FloatMap]:
    """Return disparity, deviation, doubt and confidence (height, width)."""
    rng = np.random.default_rng(seed)
    disparity_px, sigma_px = np.exp(rng.uniform(-7, 5, size)), np.exp(rng.uniform(-4, 3, size))
    maps = disparity_px, sigma_px, rng.normal(0, 3, size), rng.uniform(0, 1, size)
    return tuple(map_.astype(np.float32) for map_ in maps)  # type: ignore[return-value]


def some_image(size: tuple[int, int], seed: int) -> Image:
    """Draw an image (height, width, 3) of few colours."""
    return (40 * np.random.default_rng(seed).integers(0, 3, (*size, 3))).astype(np.uint8)


def some_choice(seed: int, clues: int = CLUES) -> SurfaceChoice:
    rng = np.random.default_rng(seed)
    sides = clues, *HIDDEN, OFFERED
    layers = (
        (rng.normal(0, 1, side).astype(np.float32), rng.normal(0, 1, side[1]).astype(np.float32))
        for side in pairwise(sides)
    )
    return SurfaceChoice(tuple(layers))


def window(map_: FloatMap, row: int, column: int, side: int) -> FloatMap:
    """Return the values of a window around a pixel, as far as there are any."""
    reach = side // 2
    return map_[max(0, row - reach) : row + reach + 1, max(0, column - reach) : column + reach + 1]


@given(SIZES, st.integers(0, 10**6))
@settings(deadline=None, max_examples=30)
def test_offered_are_the_extremes_of_the_windows(size: tuple[int, int], seed: int) -> None:
    disparity_px = some_maps(size, seed)[0]
    at = np.arange(disparity_px.size)
    offered_px = surface_choice.offer(disparity_px, at)
    for index in at:
        place = divmod(int(index), size[1])
        expected = [disparity_px[place]]
        expected += [window(disparity_px, *place, side).max() for side in NEAREST]
        expected += [window(disparity_px, *place, side).min() for side in FARTHEST]
        assert offered_px[:, index].tolist() == expected


@given(SIZES, st.integers(0, 10**6))
@settings(deadline=None, max_examples=15)
def test_nothing_comes_out_that_was_nowhere_near(size: tuple[int, int], seed: int) -> None:
    maps = some_maps(size, seed)
    apart = np.random.default_rng(seed).random(size) < 0.2
    chosen_px = some_choice(seed)(maps, some_image(size, seed), apart)
    sure = (maps[3] >= UNSURE) | apart
    assert np.array_equal(chosen_px[sure], maps[0][sure])
    for row, column in np.argwhere(~sure):
        around_px = window(maps[0], row, column, max(NEAREST + FARTHEST))
        assert around_px.min() * (1 - 1e-5) <= chosen_px[row, column] <= around_px.max() * (1 + 1e-5)


def test_the_rule_is_the_dense_network_that_was_fitted() -> None:
    maps = some_maps((20, 30), 3)
    choice, at = some_choice(4), np.arange(600)
    offered_px = surface_choice.offer(maps[0], at)
    clues = surface_choice.see(offered_px, maps, some_image((20, 30), 5), at)
    net = nn.Sequential(
        *(
            part
            for side in zip((CLUES, *HIDDEN), (*HIDDEN, OFFERED), strict=True)
            for part in (nn.Linear(*side), nn.ReLU())
        )
    )[:-1]
    with torch.inference_mode():
        for layer, (weight, bias) in zip(net[::2], choice.layers, strict=True):
            layer.weight.copy_(torch.from_numpy(weight.T))
            layer.bias.copy_(torch.from_numpy(bias))
        share = net.double()(torch.from_numpy(clues.T).double()).softmax(1).numpy()
    assert np.allclose(choice.decide(clues, offered_px), (share * offered_px.T).sum(1), rtol=1e-3)


def slow_look_around(map_log: FloatMap, trust: FloatMap, image: Image, place: tuple[int, int]) -> list[float]:
    """Return what surroundings.gather says of one pixel: means weighted by trust, by colour too, and their spread."""
    (row, column), (reach, step) = place, surface_choice.GRID
    around = [
        (
            min(max(row + down, 0), map_log.shape[0] - 1),
            min(max(column + right, 0), map_log.shape[1] - 1),
        )
        for down in range(-reach, reach + 1, step)
        for right in range(-reach, reach + 1, step)
    ]
    more = np.array([float(map_log[there]) - float(map_log[place]) for there in around])
    plain = np.array([float(trust[there]) ** 2 for there in around])
    steps = np.array([np.abs(image[there].astype(int) - image[place].astype(int)).sum() for there in around])
    alike = plain * np.exp(-steps / surface_choice.ALIKE_GREY)
    mean = np.average(more, weights=alike)
    spread = np.sqrt(np.average((more - mean) ** 2, weights=alike))
    return [mean, np.average(more, weights=plain), np.log(alike.sum() / plain.sum()), spread]


@given(SIZES, st.integers(0, 10**6))
@settings(deadline=None, max_examples=10)
def test_neighbours_of_a_colour_count_by_trust_and_colour(size: tuple[int, int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    map_log, trust = (rng.uniform(low, 1, size).astype(np.float32) for low in (-1, 0.3))
    image = some_image(size, seed)
    at = np.arange(map_log.size)
    found = surface_choice.look_around(map_log, trust, image, at)
    for index in at:
        expected = slow_look_around(map_log, trust, image, divmod(int(index), size[1]))
        assert np.allclose(found[:, index], expected, atol=2e-3)


def test_a_neighbour_of_the_same_colour_says_which_side_of_an_outline_a_pixel_is_on() -> None:
    map_log = np.where(np.arange(20) < 10, 1.0, 3.0).astype(np.float32) * np.ones((9, 1), np.float32)
    image = np.where(np.arange(20) < 8, 50, 200).astype(np.uint8)[None, :, None] * np.ones((9, 1, 3), np.uint8)
    at = np.array([4 * 20 + 8])  # the map calls it far; its colour is that of the near side
    mean, plain, share, _ = surface_choice.look_around(map_log, np.ones((9, 20), np.float32), image, at)
    assert mean[0] > plain[0] + 0.3 and share[0] < 0


def test_rules_of_before_look_at_the_first_clues() -> None:
    maps, image = some_maps((12, 16), 6), some_image((12, 16), 7)
    old = some_choice(8, FIRST_CLUES)
    weight, bias = old.layers[0]
    blind = np.concatenate([weight, np.zeros((CLUES - FIRST_CLUES, len(bias)), np.float32)])
    assert np.allclose(old(maps, image), SurfaceChoice(((blind, bias), *old.layers[1:]))(maps, image), rtol=1e-5)


def made_pixels(seed: int, n: int = 6000, *, wide: bool = False) -> UnsurePixels:
    """Draw pixels whose truth is the nearest value within 5 px where the confidence is below 0.4, else their own.

    Of a wide rule it is the sure neighbour below instead.
    """
    rng = np.random.default_rng(seed)
    clues = rng.normal(0, 1, (WIDE_CLUES if wide else CLUES, n)).astype(np.float32)
    clues[0] = rng.uniform(0, UNSURE, n)
    offered_px = np.sort(np.exp(rng.uniform(1, 5, (OFFERED, n))), axis=0)[[2, 3, 4, 5, 6, 1, 0]].astype(np.float32)
    if wide:
        farther_px = np.exp(rng.uniform(1, 5, (WIDE_OFFERED - OFFERED, n))).astype(np.float32)
        offered_px = np.concatenate([offered_px, farther_px])
    truth_px = np.where(clues[0] < 0.4, offered_px[-1 if wide else 1 + NEAREST.index(5)], offered_px[0])
    part = np.arange(n) % surface_fit.PARTS
    return UnsurePixels(clues, offered_px, truth_px, np.ones(n, np.float32), part, np.full(n, "street"))


@pytest.mark.parametrize("wide", [False, True])
def test_fit_finds_which_surface_counts_on_new_pixels(monkeypatch: pytest.MonkeyPatch, wide: bool) -> None:
    monkeypatch.setattr(surface_fit, "STEPS", 150)
    monkeypatch.setattr(surface_fit, "BATCH", 512)
    choice, new = surface_fit.fit(made_pixels(0, wide=wide)), made_pixels(1, 2000, wide=wide)
    before, after = (
        np.abs(new.truth_px / found_px - 1).mean()
        for found_px in (new.offered_px[0], choice.decide(new.clues, new.offered_px))
    )
    assert before > 0.3 and after < 0.3 * before


def test_cross_validation_tells_before_and_after_of_each_source(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surface_fit, "STEPS", 5)
    pixels = made_pixels(2)
    two = replace(pixels, source=np.where(np.arange(6000) < 3000, "street", "kitti2015"))
    lines = list(surface_fit.cross_validate(two))
    assert [line.split(",")[0] for line in lines] == ["street", "kitti2015"]
    assert all("then AbsRel" in line for line in lines)
    alone = list(surface_fit.cross_validate(replace(pixels, part=np.zeros(6000, np.int64))))
    before, after = alone[0].split(": ", 1)[1].split("; then ")
    assert before == after  # there is nothing to leave out and to learn from


def test_header_keeps_the_choice(tmp_path: Path) -> None:
    path, choice = tmp_path / "w.safetensors", some_choice(1)
    weights.write(path, nn.Linear(2, 2), {"net": "cfnet"})
    assert SurfaceChoice.read(weights.read_about(path)) is None
    weights.rewrite_about(path, **{surface_choice.ENTRY: choice.record()})
    found = SurfaceChoice.read(weights.read_about(path))
    assert found is not None
    for held, given_ in zip(found.layers, choice.layers, strict=True):
        assert all(np.allclose(a, b, atol=6e-5) for a, b in zip(held, given_, strict=True))


def test_shipped_rules_look_at_all_clues() -> None:
    """Those of cfnet at what is around, the others farther."""
    narrow, wide = (CLUES, *HIDDEN, OFFERED), (WIDE_CLUES, *HIDDEN, WIDE_OFFERED)
    networks = (SurfaceChoice.read(weights.read_about(weights.find(net, "s"))) for net in ("cfnet", "pcwnet"))
    for choice, sides in zip((*networks, classical.load_choice()), (narrow, wide, wide), strict=True):
        assert choice is not None
        assert [weight.shape for weight, _ in choice.layers] == list(pairwise(sides))


def test_classical_stereo_errs_less_around_a_post_that_is_plain() -> None:
    """A post of one colour before a wall: the filling blurs its outline, and one of both surfaces is right."""
    rng = np.random.default_rng(0)
    wall = cv2.GaussianBlur(rng.integers(0, 256, (120, 400)).astype(np.uint8), (0, 0), 1.0)
    left, right, truth_px = wall[:, :320].copy(), wall[:, 6:326].copy(), np.full((120, 320), 6, np.float32)
    left[20:, 150:210], right[20:, 120:180], truth_px[20:, 150:210] = 255, 255, 30
    found = classical.smooth(left, right)[0], classical.estimate(left, right, 48)[0]
    before, after = (float(np.abs(map_px / truth_px - 1).mean()) for map_px in found)
    assert after < before
    apart = classical.estimate(left, right, 48, np.ones((120, 320), np.bool_))[0]
    assert np.array_equal(apart, classical.smooth(left, right, 48)[0])  # the sky keeps what was matched


def clipped_van() -> tuple[Image, Image, Mask]:
    """Draw both views of a street with a van at 2 m on its left, and tell where its side is clipped white."""
    rng = np.random.default_rng(0)
    row, column = np.mgrid[:375, :1242]
    texture = cv2.GaussianBlur(rng.integers(0, 256, (375, 1242)).astype(np.uint8), (0, 0), 1.2)
    van = (row >= 150) & (row < 330) & (column < 420)
    clipped = (row >= 158) & (row < 322) & (column >= 8) & (column < 412)
    truth_px = np.where(van, 190, np.maximum(4, 0.4 * (row - 170.0))).astype(np.float32)
    left = np.where(clipped, 255, np.where(van, texture // 2 + 60, texture))
    right = cv2.GaussianBlur(rng.integers(0, 256, (375, 1242)).astype(np.uint8), (0, 0), 1.2)
    for part in (~van, van):  # the near one is drawn last
        place = np.rint(column - truth_px).astype(int)
        seen = part & (place >= 0)
        right[row[seen], place[seen]] = left[seen]
    noisy = (np.clip(view + rng.normal(0, 2, view.shape), 0, 255).astype(np.uint8) for view in (left, right))
    return next(noisy), next(noisy), clipped


def test_clipped_white_of_a_near_van_does_not_become_the_far_background() -> None:
    """Neither eye sees anything there, and what is filled in comes from behind: a hundred metres instead of two."""
    left, right, clipped = clipped_van()
    found = classical.smooth(left, right)[0], classical.estimate(left, right, 208)[0]
    before, after = (float((map_px < 8)[clipped].mean()) for map_px in found)  # beyond 48 m
    assert before > 0.2 and after < 0.05


def test_what_nothing_matched_stays_without_a_value() -> None:
    black = np.zeros((40, 60), np.uint8)
    disparity_px, _ = classical.estimate(black, black, 16)
    assert not disparity_px.any()


@pytest.mark.networks
def test_command_writes_the_header_and_leaves_the_tensors(
    tmp_path: Path,
    street: Path,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(surface_fit, "STEPS", 3)
    path, before = tmp_path / "mine.safetensors", weights.load(weights.find("cfnet", "s"))
    weights.write(path, runtime.create("cfnet", "s"), {"net": "cfnet", "size": "s"})
    held = weights.load(path).tensors
    assert priors.PROGRAM.run(["train", "surfaces", str(path), "--street", str(street), "--wide"]) == 0
    assert capsys.readouterr().out.startswith("street, ")
    after = weights.load(path)
    choice = SurfaceChoice.read(after.about)
    assert choice is not None and choice.layers[-1][1].size == WIDE_OFFERED
    assert after.about.keys() <= before.about.keys()
    assert all(torch.equal(held[name], value) for name, value in after.tensors.items())
    with pytest.raises(DataError, match="no pairs with truth"):
        surface_fit.collect(surface_fit.matcher_of(runtime.open_net("cfnet", "s", "fp32")), {}, {})


def test_other_networks_have_no_choice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mono.safetensors"
    weights.write(path, runtime.create("bts", "s"), {"net": "bts", "size": "s"})
    assert priors.PROGRAM.run(["train", "surfaces", str(path)]) == 1
    assert "of bts, which does not match" in capsys.readouterr().err
