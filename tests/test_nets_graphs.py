"""Networks as ONNX graphs: the exported forms against plain torch, and all four networks in onnxruntime."""

from pathlib import Path

import numpy as np
import pytest
import torch
from test_nets import random_pair
from torch import Tensor, nn

from eval.files import write_bytes
from priors.errors import DataError
from priors.methods.completion import Completion
from priors.methods.mono import Mono
from priors.nets import cost_volume, graphs, onnx_matching, runtime, upsample, weights
from priors.nets.blocks import Exact, UpsampleConv, conv3d, fold
from priors.nets.onnx_volume import PlaneConv, PlaneHead, Planes, PlaneUpsampleConv, beside, portable, weigh
from priors.types import Camera


def folded(layers: nn.Module, seed: int = 0) -> nn.Module:
    torch.manual_seed(seed)
    for module in layers.modules():
        if isinstance(module, nn.BatchNorm3d):
            nn.init.uniform_(module.running_mean, -1, 1)
            nn.init.uniform_(module.running_var, 0.5, 2)
    return fold(layers.eval()).requires_grad_(False)


def cut(volume_: Tensor) -> Planes:
    return Planes(volume_.unbind(4))


def whole(planes: Planes) -> Tensor:
    return torch.stack(planes.maps, dim=4)


# --- the exported forms equal the plain ones


@pytest.mark.parametrize("stride", [1, 2])
def test_a_convolution_of_planes_is_a_3d_one(stride: int) -> None:
    layer = folded(conv3d(5, 6, stride=stride))
    x = torch.randn(2, 5, 6, 8, 4)
    torch.testing.assert_close(whole(PlaneConv(layer[0])(cut(x))), layer(x), atol=1e-5, rtol=1e-5)


def test_a_climb_of_planes_is_a_3d_one() -> None:
    layer = folded(nn.Sequential(UpsampleConv(*conv3d(5, 6))))[0]
    small, plus = torch.randn(2, 5, 3, 4, 2), torch.randn(2, 6, 6, 8, 4)
    found = whole(PlaneUpsampleConv(layer)(cut(small), cut(plus)))
    torch.testing.assert_close(found, layer(small, plus), atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("planes", [1, 5])
def test_a_head_of_planes_is_a_3d_one(planes: int) -> None:
    layer = folded(Exact(conv3d(5, 6), nn.Conv3d(6, 1, 3, padding=1)))
    x = torch.randn(2, 5, 4, 7, planes)
    torch.testing.assert_close(PlaneHead(layer)(cut(x)), layer(x), atol=1e-5, rtol=1e-5)


def test_planes_are_joined_and_weighed_like_volumes() -> None:
    x, y, gate = torch.randn(2, 3, 4, 5, 6), torch.randn(2, 2, 4, 5, 6), torch.randn(2, 3, 4, 5)
    assert torch.equal(whole(beside(cut(x), cut(y))), beside(x, y))
    assert torch.equal(whole(weigh(cut(x), gate)), weigh(x, gate))


def test_making_a_network_portable_leaves_it_as_it_was() -> None:
    net = folded(nn.Sequential(nn.Sequential(conv3d(2, 3), conv3d(3, 4))))
    made = portable(net)
    assert isinstance(made[0][0], PlaneConv) and isinstance(net[0][0][0], nn.Conv3d)


@pytest.mark.parametrize("width", [2, 9])
def test_planar_matching_equals_plain_torch(width: int) -> None:
    left, right, disparity_px = random_pair(4, width)
    units = [cost_volume.unit(v.permute(0, 3, 1, 2), 2) for v in (left, right)]
    views = [v.permute(0, 3, 1, 2) for v in (left, right)]
    found = onnx_matching.lookup(*views, disparity_px, 2).permute(0, 2, 3, 4, 1)
    torch.testing.assert_close(found, cost_volume.lookup(*units, disparity_px, 2), atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(
        whole(onnx_matching.correlate(*views, 2, 5)), cost_volume.correlate(*units, 2, 5), atol=1e-5, rtol=1e-5
    )
    assert torch.equal(whole(onnx_matching.concatenate(*views, 5)), cost_volume.concatenate(*views, 5))


@pytest.mark.parametrize("window", [None, 1])
def test_planar_expectation_equals_plain_torch(window: int | None) -> None:
    logits = 5 * torch.randn(2, 3, 4, 6)
    for position in (torch.arange(6.0), 9 * torch.rand(2, 3, 4, 6)):
        ours, twin = onnx_matching.expect(logits, position, window), cost_volume.expect(logits, position, window)
        torch.testing.assert_close(ours, twin, atol=1e-4, rtol=1e-5)


def test_planar_upsampling_equals_plain_torch() -> None:
    values, logits = torch.rand(2, 3, 5, 4), 20 * torch.randn(2, 36, 5, 4)
    torch.testing.assert_close(
        onnx_matching.convex(values, logits, 2, upsample.LARGEST),
        upsample.convex(values, logits, 2),
        atol=1e-5,
        rtol=1e-5,
    )


# --- bts and mffnet in onnxruntime; the stereo networks are in test_nets_runtime.py


def network(name: str, size: str) -> nn.Module:
    """A network whose heads say something."""
    torch.manual_seed(0)
    net = runtime.create(name, size).eval()
    for module in net.modules():
        if isinstance(module, nn.BatchNorm2d):
            nn.init.normal_(module.running_mean, std=0.1)
            nn.init.uniform_(module.running_var, 0.5, 1.5)
        elif isinstance(module, nn.Conv2d):
            nn.init.normal_(module.weight, std=(2 / module.weight[0].numel()) ** 0.5)
    return net


@pytest.mark.parametrize(("name", "size"), [("bts", "s"), ("bts", "m"), ("mffnet", "s")])
@pytest.mark.parametrize("shape", [(64, 96), (45, 70)])
def test_onnx_equals_torch(name: str, size: str, shape: tuple[int, int]) -> None:
    given = graphs.FORMS[name].examples(*shape)
    exact = runtime.make_ready(network(name, size), "fp32")(*given)
    found = graphs.Portable(runtime.make_ready(network(name, size), "onnx"), name)(*given)
    for field in graphs.FORMS[name].outputs:
        ours, theirs = getattr(found, field), getattr(exact, field)
        assert ours.shape == theirs.shape and theirs.std() > 0
        torch.testing.assert_close(ours, theirs, atol=1e-3, rtol=2e-3)


def test_graphs_are_kept_a_size_and_hold_the_header() -> None:
    ready = runtime.make_ready(network("mffnet", "s"), "onnx", {"net": "mffnet"})
    net = graphs.Portable(ready, "mffnet")
    for width in (32, 64, 32):
        assert net(*graphs.FORMS["mffnet"].examples(32, width)).depth_m.shape == (1, 32, width)
    assert len(net.sessions) == 2
    session = next(iter(net.sessions.values()))
    assert session.get_modelmeta().custom_metadata_map["roadprior"] == '{"net": "mffnet"}'


def test_the_methods_run_in_onnxruntime(tmp_path: Path) -> None:
    from priors.methods._mono_network import estimate
    from priors.methods._network import Network

    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (45, 70, 3), dtype=np.uint8)
    camera = Camera(np.array([[100.0, 0, 35], [0, 100, 15], [0, 0, 1]]), (45, 70))
    file = tmp_path / "bts-s.safetensors"
    weights.write(file, network("bts", "s"), {"net": "bts", "size": "s"})
    ours, theirs = (estimate(Network("bts", "s", how, file).open(), image, camera).values for how in ("onnx", "fp32"))
    np.testing.assert_allclose(ours, theirs, rtol=5e-3)
    assert Mono(size="s", runtime="onnx", weights=file).weights_digest()
    file = tmp_path / "mffnet-s.safetensors"
    weights.write(file, network("mffnet", "s"), {"net": "mffnet", "size": "s"})
    sparse_m = np.where(rng.random((45, 70)) < 0.1, np.float32(20), np.float32(0))
    made = [
        Completion(model="mffnet", size="s", runtime=how, weights=file).fill(sparse_m, image, camera)
        for how in ("onnx", "fp32")
    ]
    np.testing.assert_allclose(made[0].depth_m, made[1].depth_m, rtol=5e-3)


def test_a_file_that_completion_cannot_run_is_named(tmp_path: Path) -> None:
    file = tmp_path / "a.onnx"
    write_bytes(file, b"")
    with pytest.raises(DataError, match="bf16"):
        runtime.choose("bf16", file)
