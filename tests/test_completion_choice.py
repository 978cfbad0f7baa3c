"""Which depth a completion network's pixel gets where it is unsure, and how that rule is fitted."""

from pathlib import Path

import numpy as np
import pytest
import torch
from test_completion_gate import file  # noqa: F401
from test_learn_completion import scene, street  # noqa: F401
from test_mffnet import F

from priors.learn import choice_fit
from priors.learn.choice_fit import KnownPixels
from priors.methods import _completion_choice as choice
from priors.methods._completion_choice import CLUES, ENTRY, OFFERED, DepthChoice, Maps, find_unsure, see
from priors.methods.completion import Completion
from priors.nets import weights
from priors.nets.surface_choice import SurfaceChoice

pytestmark = pytest.mark.networks
SIZE = (40, 60)


def maps(seed: int = 0, samples: int = 120, scale: float = 1.0) -> Maps:
    """A step between two surfaces, samples of both, and a network that is off by some per cent."""
    rng = np.random.default_rng(seed)
    truth_m = np.where(np.arange(SIZE[1]) < 30, 8.0, 20.0) + 0.05 * np.arange(SIZE[0])[:, None]
    net_m = truth_m * np.exp(rng.normal(0, 0.03, SIZE))
    fill_m = truth_m * np.exp(rng.normal(0, 0.03, SIZE))
    sparse_m, at = np.zeros(SIZE), rng.choice(SIZE[0] * SIZE[1], samples, replace=False)
    sparse_m.reshape(-1)[at] = truth_m.reshape(-1)[at] * np.exp(rng.normal(0, 0.01, samples))
    error, certain = rng.uniform(0.005, 0.1, SIZE), rng.uniform(0, 1, SIZE)
    depths = (np.ascontiguousarray(scale * map_, F) for map_ in (net_m, fill_m, sparse_m))
    return *depths, error.astype(F), certain.astype(F)


def always(number: int) -> DepthChoice:
    """A rule that takes one of what is offered."""
    bias = np.full(OFFERED, -30, F)
    bias[number] = 30
    return DepthChoice(SurfaceChoice(((np.zeros((CLUES, OFFERED), F), bias),)))


def offered_slowly(given: Maps, at: int) -> list[float]:
    """What is offered at a pixel, by loops over the samples."""
    net_m, fill_m, sparse_m, *_ = given
    height, width = sparse_m.shape
    row, column = divmod(at, width)
    places = [(r, c) for r in range(height) for c in range(width) if sparse_m[r, c] > 0]
    distance = {place: np.hypot(place[0] - row, place[1] - column) for place in places}
    half = choice.AROUND[0] // 2, choice.AROUND[1] // 2
    around = [sparse_m[r, c] for r, c in places if abs(r - row) <= half[0] and abs(c - column) <= half[1]]
    beside = choice.BESIDE // 2
    missed = [
        np.log(sparse_m[r, c] / net_m[r, c])
        for r, c in places
        if abs(r - row) <= beside and abs(c - column) <= beside and abs(np.log(sparse_m[r, c] / net_m[r, c])) < 0.05
    ]
    nearest = min(distance.values())
    net = float(net_m[row, column])
    close = [sparse_m[place] for place in places if distance[place] <= nearest + 0.6]  # the transform is not exact
    return [net, float(fill_m[row, column]), close, min(around, default=net), max(around, default=net),
            net * float(np.exp(sum(missed) / (len(missed) + 1)))]  # fmt: skip


def test_what_is_offered_is_what_samples_around_say() -> None:
    given = maps()
    rows, columns = np.meshgrid(np.arange(4, 36, 5), np.arange(4, 56, 6), indexing="ij")
    at = np.ravel_multi_index((rows.ravel(), columns.ravel()), SIZE)
    found = np.exp(see(given, at).offered)
    for number, pixel in enumerate(at):
        net, fill, close, low, high, moved = offered_slowly(given, int(pixel))
        np.testing.assert_allclose(found[[0, 1, 3, 4, 5], number], [net, fill, low, high, moved], rtol=1e-4)
        assert np.isclose(close, found[2, number], rtol=1e-5).any()


def test_far_from_samples_the_network_stands_for_what_they_would_show() -> None:
    net_m, fill_m, sparse_m, *rest = maps()
    alone = np.zeros_like(sparse_m)
    alone[0, 0] = 5.0
    pixels = see((net_m, fill_m, alone, *rest), np.arange(net_m.size))
    far = np.ravel_multi_index((30, 50), SIZE)
    np.testing.assert_allclose(np.exp(pixels.offered[[0, 3, 4, 5], far]), net_m[30, 50], rtol=1e-5)
    assert np.exp(pixels.offered[2, far]) == pytest.approx(5.0)
    assert np.isfinite(pixels.clues).all() and pixels.clues.shape == (CLUES, net_m.size)


@pytest.mark.parametrize("number", range(OFFERED))
def test_a_pixel_gets_what_the_rule_takes_and_sure_ones_stay(number: int) -> None:
    given, near = maps(), np.ones(SIZE, bool)
    near[:, :9] = False
    asked = find_unsure(given, near)
    chosen_m = always(number)(given, near)
    net, taken = given[0].reshape(-1)[asked], np.exp(see(given, asked).offered[number])
    np.testing.assert_allclose(chosen_m.reshape(-1)[asked], net * (taken / net) ** choice.SAY, rtol=1e-5)
    stays = np.setdiff1d(np.arange(chosen_m.size), asked)
    assert np.array_equal(chosen_m.reshape(-1)[stays], given[0].reshape(-1)[stays]) and 0 < stays.size < chosen_m.size
    unsure = (given[3] > choice.UNSURE) | (np.abs(given[0] - given[1]) > choice.APART * given[1])
    assert np.array_equal(asked, np.flatnonzero(unsure & near))


def test_twice_the_depths_in_give_twice_the_depths_out() -> None:
    rng = np.random.default_rng(3)
    rule = DepthChoice(SurfaceChoice(((rng.normal(0, 0.3, (CLUES, OFFERED)).astype(F), np.zeros(OFFERED, F)),)))
    once, far = (rule(maps(scale=scale), np.ones(SIZE, bool)) for scale in (1.0, 64.0))
    np.testing.assert_allclose(far, 64 * once, rtol=1e-3)


def test_where_nothing_is_unsure_the_network_stays() -> None:
    net_m, _, sparse_m, error, certain = maps()
    given = net_m, net_m.copy(), sparse_m, np.zeros_like(error), certain
    assert np.array_equal(always(3)(given, np.ones(SIZE, bool)), net_m)


def made_pixels(seed: int, n: int = 6000) -> KnownPixels:
    """Pixels where the fill is right if the third clue is above 0, else the network."""
    rng = np.random.default_rng(seed)
    clues, offered = rng.normal(0, 1, (CLUES, n)).astype(F), rng.normal(2, 0.3, (OFFERED, n)).astype(F)
    truth = np.where(clues[2] > 0, offered[1], offered[0])
    part = np.arange(n) % choice_fit.PARTS
    return KnownPixels(clues, offered, truth, np.ones(n, F), part, np.where(part < 2, "one", "other"))


def test_a_rule_is_learned(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(choice_fit, "STEPS", 200)
    monkeypatch.setattr(choice_fit, "BATCH", 512)
    before = torch.get_rng_state()
    rule, new = choice_fit.fit(made_pixels(0)), made_pixels(1, 2000)
    assert torch.equal(torch.get_rng_state(), before), "it draws from no one else's numbers"
    error, was = (
        np.abs(found - new.truth).mean() for found in (rule.rule.decide(new.clues, new.offered), new.offered[0])
    )
    assert error < 0.3 * was
    again = DepthChoice.read({ENTRY: rule.record()})
    assert again is not None
    np.testing.assert_allclose(
        again.rule.decide(new.clues, new.offered), rule.rule.decide(new.clues, new.offered), atol=0.01
    )
    assert DepthChoice.read({}) is None


def test_a_file_is_fitted_by_the_command(
    file: Path,  # noqa: F811
    street: Path,  # noqa: F811
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The file's network makes everything half as far again: the rule finds the way back to the samples."""
    from cli import priors

    shown = scene()
    sparse_m = np.where(np.arange(288)[:, None] % 2 == 0, choice_fit.drop_points(
        shown, np.random.default_rng(0), choice_fit.Density()).sparse_m, F(0))  # fmt: skip
    method = Completion(model="mffnet", weights=file, runtime="fp32")
    before_m = method.fill(sparse_m, shown.image, shown.camera).depth_m
    monkeypatch.setattr(choice_fit, "STEPS", 200)
    monkeypatch.setattr(choice_fit, "BATCH", 512)
    assert priors.PROGRAM.run(["train", "choice", str(file), "--street", str(street)]) == 0
    assert "street, " in capsys.readouterr().out
    held = weights.read_about(file)[ENTRY]
    assert np.shape(held[0][0]) == (CLUES, choice_fit.HIDDEN[0])
    after_m = method.fill(sparse_m, shown.image, shown.camera).depth_m
    known = (before_m > 0) & (shown.truth_m > 0)
    was, now = (np.abs(map_[known] / shown.truth_m[known] - 1).mean() for map_ in (before_m, after_m))
    assert now < 0.6 * was


def test_other_networks_choose_no_depth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from cli import priors
    from priors.nets import bts

    torch.manual_seed(0)
    weights.write(tmp_path / "mono.safetensors", bts.Bts("s"), {"net": "bts", "size": "s"})
    assert priors.PROGRAM.run(["train", "choice", str(tmp_path / "mono.safetensors")]) == 1
    assert "completion network" in capsys.readouterr().err


def test_what_ships_has_a_rule() -> None:
    about = weights.read_about(weights.find("mffnet", "s", None))
    rule = DepthChoice.read(about)
    assert rule is not None
    assert rule.rule.layers[0][0].shape[0] == CLUES and rule.rule.layers[-1][1].shape == (OFFERED,)
