"""The sky mask's network in numpy against PyTorch, and what training is fed with."""

from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from priors import sky
from priors.kernels import sky_net as kernels
from priors.learn import fit_sky, sky_augment, sky_evidence, sky_left_out
from priors.learn.sky_branches import grow_trees
from priors.learn.sky_labels import REST, SKY, UNKNOWN, SkySample
from priors.learn.sky_net import SkyNet, fold

pytestmark = pytest.mark.networks


@pytest.fixture(scope="module")
def net() -> SkyNet:
    """A network whose normalisations have seen something, so that folding them matters."""
    torch.manual_seed(0)
    made = SkyNet()
    for module in made.modules():
        if isinstance(module, torch.nn.BatchNorm2d):
            module.running_mean = torch.randn_like(module.weight) * 0.2
            module.running_var = torch.rand_like(module.weight) + 0.5
    return made.eval()


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (17, 5), (33, 64)])
def test_layers_in_numpy_equal_the_twin(net: SkyNet, size: tuple[int, int]) -> None:
    colour = np.random.default_rng(1).random((*size, 3), np.float32)
    with torch.inference_mode():
        expected = net(torch.from_numpy(colour).permute(2, 0, 1)[None])[0].numpy()
    found = kernels.forward(colour, sky.pair_layers(fold(net)))
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())


@given(st.integers(1, 9), st.integers(1, 9), st.sampled_from([3, 5]), st.sampled_from([1, 2]), st.integers(0, 99))
@settings(deadline=None, max_examples=30)
def test_each_channel_is_convolved_with_its_own_kernel(h: int, w: int, side: int, stride: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values, weights = rng.normal(size=(2, h, w)).astype(np.float32), rng.normal(size=(2, side, side)).astype(np.float32)
    bias = rng.normal(size=2).astype(np.float32)
    found = kernels.look(values, (weights, bias), stride)
    reach = side // 2
    padded = np.pad(values.astype(float), ((0, 0), (reach, reach), (reach, reach)))
    assert found.shape == (2, -(-h // stride), -(-w // stride))
    for c, y, x in np.ndindex(found.shape):
        window = padded[c, y * stride : y * stride + side, x * stride : x * stride + side]
        assert found[c, y, x] == pytest.approx(np.clip((window * weights[c]).sum() + bias[c], 0, 6), abs=1e-4)


@given(st.integers(1, 7), st.integers(1, 5), st.sampled_from([1, 5, 511, 513]), st.booleans(), st.integers(0, 99))
@settings(deadline=None, max_examples=30)
def test_channels_are_mixed_pixel_by_pixel(inputs: int, outputs: int, count: int, clipped: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values, weights = rng.normal(size=(inputs, 1, count)).astype(np.float32), rng.normal(size=(inputs, outputs))
    bias = rng.normal(size=outputs).astype(np.float32)
    found = kernels.mix(values, (weights.astype(np.float32), bias), clipped)
    expected = np.einsum("io,iyx->oyx", weights, values) + bias[:, None, None]
    np.testing.assert_allclose(found, np.clip(expected, 0, 6) if clipped else expected, atol=1e-4)


def test_weights_are_read_as_they_were_written(net: SkyNet, tmp_path: Path) -> None:
    layers = fit_sky.as_layers(fold(net))
    fit_sky.write(tmp_path / "sky.npz", layers)
    again = sky.read_weights(tmp_path / "sky.npz")
    assert again.keys() == layers.keys() == sky.load_weights().keys()
    for name, layer in layers.items():
        for mine, theirs in zip(layer, again[name], strict=True):
            np.testing.assert_array_equal(mine, theirs)


def sample(place: str, seed: int) -> SkySample:
    """A bright sky above a dark, rough ground."""
    rng = np.random.default_rng(seed)
    image = np.full((96, 160, 3), 225, np.uint8)
    image[40:] = rng.integers(20, 90, (56, 160, 3))
    label = np.where(np.arange(96)[:, None] < 40, SKY, REST) * np.ones((1, 160))
    label[38:42] = UNKNOWN
    return SkySample(place, image, label.astype(np.float32))


def test_bare_trees_stand_before_the_sky_alone() -> None:
    one = sample("0001", 0)
    for seed in range(4):
        image, label = grow_trees(one.image, one.label, np.random.default_rng(seed))
        cut = (one.label == SKY) & (label == REST)
        assert 0 < cut.sum() < 0.6 * (one.label == SKY).sum()
        assert image[cut].max() < 190
        np.testing.assert_array_equal(label[one.label != SKY], one.label[one.label != SKY])
        np.testing.assert_array_equal(image[one.label != SKY], one.image[one.label != SKY])


def test_walls_are_lit_and_the_sky_is_not() -> None:
    mask = np.zeros((20, 60), np.float32)
    mask[:8] = 1
    light = np.full((20, 60, 3), 0.2, np.float32)
    lit = sky_augment.light_walls(light, mask, np.random.default_rng(3))
    np.testing.assert_array_equal(lit[:8], light[:8])
    assert lit[8:].max() > 0.25 and (lit >= light - 1e-6).all()


def test_a_wall_that_was_matched_is_no_sky_whatever_the_networks_say() -> None:
    logit = np.full((200, 300), -5, np.float32)
    logit[:100] = 5
    matched_px = np.zeros((200, 300), np.float32)
    matched_px[20:90, 30:120:3] = 40  # a wall with a few matches
    matched_px[110:, :] = 8
    matched_px[100:108] = 1.5  # the far end of the street, below the sky
    label = sky_evidence.label(logit, matched_px, np.zeros((200, 300), bool))
    assert not (label[20:90, 30:118] == SKY).any() and (label[34:76, 44:104] == REST).all()
    assert (label[10:80, 200:] == SKY).all() and (label[130:] == REST).all()
    hit = np.zeros((200, 300), bool)
    hit[50, 250:290] = True
    assert (sky_evidence.label(logit, matched_px, hit)[48:53, 250:290] == UNKNOWN).all(), "a wire before the sky"
    assert (sky_evidence.label(-logit, matched_px, hit)[50, 250:290] == REST).all()


def test_a_bright_patch_amid_something_near_is_not_called_sky() -> None:
    logit = np.full((200, 300), -5, np.float32)
    logit[40:60, 100:140] = 5
    matched_px = np.full((200, 300), 30, np.float32)
    matched_px[40:60, 100:140] = 0
    assert not (sky_evidence.label(logit, matched_px, np.zeros((200, 300), bool)) == SKY).any()


def test_the_score_is_over_known_pixels_of_all_frames() -> None:
    samples = [sample("06", 1), sample("06", 2)]
    found = np.arange(96)[:, None] * np.ones((1, 160)) < 50
    assert fit_sky.overlap(samples, lambda image: found) == pytest.approx(38 / (50 - 4))
    assert fit_sky.overlap(samples, lambda image: ~found) == 0


def test_what_is_left_out_is_never_drawn() -> None:
    samples = [sample(place, seed) for seed, place in enumerate(("0001", "0006", "0016", "06", "street"))]
    judged = []
    for task, places in sky_left_out.left_out(samples):
        assert not {one.place for one in task.samples} & set(places)
        assert {one.place for one in task.judged} == set(places)
        assert len(task.samples) + len(task.judged) == len(samples)
        judged.append(places)
    assert judged == [("0001", "06"), ("0006",), ("0016",)]


def test_training_starts_from_labels_and_learns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit_sky, "SHAPES", ((64, 96),))
    task = fit_sky.SkyTask([sample("0001", 1)], [sample("0001", 2)], batch_size=2)
    optimiser = torch.optim.Adam(task.net.parameters(), 3e-3)
    losses = []
    for step in range(12):
        loss, terms = task.loss(task.batch(step, np.random.default_rng(step)))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        losses.append(float(terms["entropy"]))
    assert np.mean(losses[-3:]) < 0.7 * losses[0]


def test_the_same_step_has_the_same_batch() -> None:
    task = fit_sky.SkyTask([sample("0001", 1)], [], batch_size=2)
    one, again = (task.batch(5, np.random.default_rng([0, 5])) for _ in range(2))
    assert all(torch.equal(one[name], again[name]) for name in one)


def test_resizing_follows_the_twin() -> None:
    values = np.random.default_rng(0).normal(size=(2, 5, 3)).astype(np.float32)
    expected = torch.nn.functional.interpolate(torch.from_numpy(values)[None], size=(9, 6), mode="bilinear")[0]
    np.testing.assert_allclose(kernels.enlarge(values, 9, 6), expected.numpy(), atol=1e-5)
