"""LPIPS: the documented value by real weights, equal to plain layers by random ones, and clear about wrong files."""

import os
from pathlib import Path

import numpy as np
import pytest

from eval.lpips import PLANS, Lpips, _shapes, _tapped, load
from eval.protocol import ScoreError

torch = pytest.importorskip("torch", reason="torch is not installed")
from torch import nn  # noqa: E402

SHARED = Path(__file__).resolve().parents[2] / "shared"
BACKBONE = SHARED / "weights" / "squeezenet1_1_fp16.npz"
HEADS = Path(os.environ.get("LPIPS_HEADS", "/nowhere"))
"""lpips/weights/v0.1/squeeze.pth of the lpips wheel."""


def random_weights(net, seed=0):
    """A backbone and heads of the right shapes."""
    generator = torch.Generator().manual_seed(seed)
    tensors = {name: torch.randn(shape, generator=generator) * 0.1 for name, shape in _shapes(net).items()}
    heads = {f"lin{i}.model.1.weight": torch.rand(1, n, 1, 1, generator=generator) for i, n in enumerate(_tapped(net))}
    return tensors, heads


def save(path, tensors):
    np.savez(path, **{name: tensor.numpy() for name, tensor in tensors.items()})
    return path


class Fire(nn.Module):
    """SqueezeNet's module, as its paper draws it."""

    def __init__(self, inputs, outputs):
        super().__init__()
        self.squeeze = nn.Conv2d(inputs, outputs // 8, 1)
        self.expand1x1 = nn.Conv2d(outputs // 8, outputs // 2, 1)
        self.expand3x3 = nn.Conv2d(outputs // 8, outputs // 2, 3, padding=1)

    def forward(self, x):
        x = self.squeeze(x).relu()
        return torch.cat([self.expand1x1(x).relu(), self.expand3x3(x).relu()], 1)


def plain_network(net):
    """The network as a list of layers, and after which ones its features are taken."""
    if net == "squeeze":

        def pool():
            return nn.MaxPool2d(3, 2, ceil_mode=True)

        layers = [nn.Conv2d(3, 64, 3, 2), nn.ReLU(), pool(), Fire(64, 128), Fire(128, 128), pool(), Fire(128, 256),
                  Fire(256, 256), pool(), Fire(256, 384), Fire(384, 384), Fire(384, 512), Fire(512, 512)]  # fmt: skip
        return layers, [1, 4, 7, 9, 10, 11, 12]
    layers, inputs = [], 3
    for width in (64, 64, 0, 128, 128, 0, 256, 256, 256, 0, 512, 512, 512, 0, 512, 512, 512):
        layers += [nn.Conv2d(inputs, width, 3, padding=1), nn.ReLU()] if width else [nn.MaxPool2d(2, 2)]
        inputs = width or inputs
    return layers, [3, 8, 15, 22, 29]


def plain_distance(net, tensors, heads, image, truth):
    """LPIPS of two (3, h, w) tensors in [-1, 1], one after the other, in float64."""
    layers, taps = plain_network(net)
    model = nn.Sequential(*layers).double()
    model.load_state_dict({name.removeprefix("features."): tensor for name, tensor in tensors.items()})
    shift, scale = torch.tensor([-0.030, -0.088, -0.188]), torch.tensor([0.458, 0.448, 0.450])
    seen = []
    for x in (image, truth):
        x, found = ((x - shift[:, None, None]) / scale[:, None, None])[None].double(), []
        for i, layer in enumerate(model):
            x = layer(x)
            if i in taps:
                found.append(x[0] / x[0].norm(dim=0))
        seen.append(found)
    return sum(
        float(((a - b) ** 2 * head[0].double()).sum(0).mean()) for a, b, head in zip(*seen, heads.values(), strict=True)
    )


@pytest.mark.parametrize("net", PLANS)
def test_equals_plain_layers(net, tmp_path):
    tensors, heads = random_weights(net)
    lpips = load([save(tmp_path / "heads.npz", heads), save(tmp_path / "backbone.npz", tensors)])
    assert lpips.net == net
    image, truth = np.random.default_rng(0).integers(0, 256, (2, 45, 62, 3), dtype=np.uint8)
    as_tensors = [torch.from_numpy(x.transpose(2, 0, 1) / np.float32(127.5) - 1) for x in (image, truth)]
    with torch.inference_mode():
        expected = plain_distance(net, tensors, heads, *as_tensors)
    assert expected > 1e-3
    assert lpips(image, truth) == pytest.approx(expected, rel=1e-4)
    assert lpips(image / 255, truth / 255) == pytest.approx(expected, rel=1e-4)
    assert lpips(image, image) == 0


def test_weights_are_read_from_all_three_formats(tmp_path):
    from safetensors.torch import save_file

    tensors, heads = random_weights("squeeze")
    whole = tensors | heads
    save_file(whole, tmp_path / "a.safetensors")
    torch.save(whole, tmp_path / "a.pth")
    save(tmp_path / "a.npz", whole)
    found = [load([tmp_path / f"a{suffix}"]) for suffix in (".safetensors", ".pth", ".npz")]
    images = np.random.default_rng(0).random((2, 32, 32, 3))
    assert len({lpips(*images) for lpips in found}) == 1


@pytest.mark.skipif(
    not (BACKBONE.exists() and HEADS.exists()), reason="set LPIPS_HEADS to the lpips wheel's squeeze.pth"
)
def test_the_documented_pair_gives_the_documented_value():
    """The example of torchmetrics' documentation: 0.1005."""
    lpips = load([BACKBONE, HEADS])
    torch.manual_seed(42)
    images, truths = torch.rand(10, 3, 100, 100) * 2 - 1, torch.rand(10, 3, 100, 100) * 2 - 1
    assert float(lpips.distances(images, truths).mean()) == pytest.approx(0.1005, abs=5e-5)


def test_wrong_files_are_named_with_the_way_out(tmp_path):
    tensors, heads = random_weights("squeeze")
    backbone = save(tmp_path / "backbone.npz", tensors)
    way_out = "LPIPS needs --lpips-weights BACKBONE HEADS"
    with pytest.raises(ScoreError, match=f"no backbone of SqueezeNet 1.1 or VGG16 in it: {way_out}"):
        load([save(tmp_path / "heads.npz", heads)])
    with pytest.raises(ScoreError, match=f"heads of no channels, expected squeeze with heads of .*{way_out}"):
        load([backbone])
    with pytest.raises(ScoreError, match=f"nowhere.npz: cannot be read .*{way_out}"):
        load([tmp_path / "nowhere.npz"])
    (tmp_path / "cut.npz").write_bytes(backbone.read_bytes()[:1000])
    with pytest.raises(ScoreError, match=r"cut.npz: expected tensors by name, found damaged or other data"):
        load([tmp_path / "cut.npz"])
    tensors["features.3.squeeze.bias"] = tensors["features.3.squeeze.bias"][:-1]
    with pytest.raises(ScoreError, match=r"features.3.squeeze.bias is missing or of another shape"):
        load([save(tmp_path / "other.npz", tensors | heads)])
    with pytest.raises(ScoreError, match="no file: no backbone"):
        load([])


def test_a_file_that_would_run_code_is_refused(tmp_path):
    class Trap:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "ran",))

    torch.save({"features.0.weight": Trap()}, tmp_path / "trap.pth")
    with pytest.raises(ScoreError, match=r"trap.pth: expected tensors by name"):
        load([tmp_path / "trap.pth"])
    assert not (tmp_path / "ran").exists()


def test_images_that_do_not_fit_are_refused():
    lpips = Lpips("squeeze", {}, [])
    with pytest.raises(ScoreError, match="two RGB images of one size, found 40x40x3, 40x41x3"):
        lpips(np.zeros((40, 40, 3)), np.zeros((40, 41, 3)))
    with pytest.raises(ScoreError, match="two RGB images"):
        lpips(np.zeros((40, 40)), np.zeros((40, 40)))
    with pytest.raises(ScoreError, match="image is 31x40: LPIPS needs 32 px each way"):
        lpips(np.zeros((31, 40, 3)), np.zeros((31, 40, 3)))
