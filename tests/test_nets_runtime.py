"""Weights, runtimes and export: files that are refused, the table that chooses, and that all runtimes agree."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
import torch
from conftest import RealData
from standin import Standin, install

from eval.files import write_bytes
from priors import codecs
from priors.errors import DataError
from priors.machine.cpu import Mode
from priors.nets import runtime, speeds, weights
from priors.nets.blocks import fold
from priors.nets.runtime import as_input, as_map, choose, make_ready, open_net

STEREO = [path for name in ("cfnet", "pcwnet") for path in sorted(weights.FOLDER.glob(f"{name}-?.safetensors"))]


def images(height: int = 40, width: int = 72, seed: int = 0) -> Any:
    return np.random.default_rng(seed).integers(0, 256, (2, height, width, 3), dtype=np.uint8)


def run(net: torch.nn.Module, how: runtime.Runtime) -> list[np.ndarray]:
    found = make_ready(net, how)(*(as_input(view) for view in images()), largest_px=32)
    return [as_map(found.disparity_px), as_map(found.sigma_px), as_map(found.doubt)]


def trained(size: str = "m") -> Standin:
    """A stand-in whose normalisation is not the identity, so that folding it is a test."""
    torch.manual_seed(1)
    net = Standin(size)
    torch.nn.init.uniform_(net.features[1].running_mean, -1, 1)
    torch.nn.init.uniform_(net.features[1].running_var, 0.5, 2)
    return net


def test_weights_come_back(tmp_path: Path) -> None:
    net, path = trained(), tmp_path / "cfnet-m.safetensors"
    about = {"net": "cfnet", "size": "m", "steps": 12, "calibration": {"scores": [0.5, 1.0]}, "by": "2 hours"}
    weights.write(path, net, about, torch.float32)
    found = weights.load(path)
    assert found.about == weights.read_about(path) == about
    other = Standin()
    weights.fill(other, found, "cfnet", "m")
    for key, value in net.state_dict().items():
        assert "tracked" in key or torch.equal(value, other.state_dict()[key])


def test_kernels_are_halved_and_norms_are_not(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    weights.write(path, trained(), {})
    kinds = {key: value.dtype for key, value in weights.load(path).tensors.items()}
    assert kinds["features.0.weight"] == torch.float16
    assert kinds["features.1.running_var"] == torch.float32


def test_the_header_can_be_changed_alone(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    weights.write(path, trained(), {"net": "cfnet", "size": "m"})
    before, name = weights.load(path), weights.digest(path)
    weights.rewrite_about(path, calibration=[1, 2])
    after = weights.load(path)
    assert after.about == {"net": "cfnet", "size": "m", "calibration": [1, 2]}
    assert all(torch.equal(value, after.tensors[key]) for key, value in before.tensors.items())
    assert weights.digest(path) != name


def test_missing_damaged_and_wrong_weights_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = install(monkeypatch, tmp_path)
    assert weights.find("cfnet", "m") == path
    with pytest.raises(DataError, match=r"cfnet in size l \(cfnet-l.safetensors\); there are cfnet-m"):
        open_net("cfnet", "l", "fp32")
    with pytest.raises(DataError, match=r"gone.safetensors: no such file"):
        open_net("cfnet", "m", "fp32", tmp_path / "gone.safetensors")
    with pytest.raises(DataError, match=r"cfnet-m.safetensors: weights of net cfnet, asked for pcwnet"):
        open_net("pcwnet", "m", "fp32", path)
    with pytest.raises(DataError, match=r"weights of size m, asked for s"):
        open_net("cfnet", "s", "fp32", path)
    nameless = tmp_path / "x.safetensors"
    weights.write(nameless, Standin("s"), {})
    with pytest.raises(
        DataError, match=r"x.safetensors: not the weights of this version's cfnet-m: \d+ tensors differ"
    ):
        open_net("cfnet", "m", "fp32", nameless)
    for content in (b"", b"PK\x03\x04 a pickle", path.read_bytes()[:-50]):
        damaged = tmp_path / "d.safetensors"
        damaged.write_bytes(content)
        with pytest.raises(DataError, match=r"d.safetensors: damaged"):
            open_net("cfnet", "m", "fp32", damaged)


def test_training_takes_over_what_fits(tmp_path: Path) -> None:
    path, other = tmp_path / "a.safetensors", Standin("m")
    weights.write(path, trained(), {}, torch.float32)
    assert weights.take(other, path) == len(weights.load(path).tensors)
    assert torch.equal(other.features[0].weight, trained().features[0].weight)
    with pytest.raises(DataError, match=r"a.safetensors: no tensor fits this network"):
        weights.take(torch.nn.Conv2d(1, 2, 3), path)


def test_a_changed_file_is_loaded_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = install(monkeypatch, tmp_path)
    first = open_net("cfnet", "m", "fp32")
    assert open_net("cfnet", "m", "fp32", path) is first
    assert open_net("cfnet", "m", "bf16") is not first
    weights.rewrite_about(path, note="new")
    assert open_net("cfnet", "m", "fp32").about["note"] == "new"


def test_threads_load_once_and_get_what_one_gets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, tmp_path)
    made = []
    monkeypatch.setattr(runtime, "create", lambda name, size: made.append(name) or Standin(size))
    pairs = [images(seed=seed) for seed in range(6)]

    def one(pair: Any) -> np.ndarray:
        ready = open_net("cfnet", "m", "fp32")
        return as_map(ready(*(as_input(view) for view in pair), largest_px=32).disparity_px)

    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(one, pairs))
    assert len(made) == 1
    assert all(np.array_equal(a, one(pair)) for a, pair in zip(together, pairs, strict=True))


@pytest.mark.parametrize(
    ("mode", "cuda", "expected"),
    [
        ("amx", False, "bf16"),
        ("avx512_bf16", False, "bf16"),
        ("avx512", False, "fp32"),
        ("avx2", False, "fp32"),
        ("plain", False, "fp32"),
        ("amx", True, "cuda"),
    ],
)
def test_auto_is_a_table(mode: Any, cuda: bool, expected: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runtime.cpu, "mode", lambda: mode)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: cuda)
    assert choose("auto") == expected
    assert choose("fp32") == "fp32"
    assert choose("auto", Path("a.onnx")) == "onnx"
    assert choose("auto", Path("a.safetensors")) == expected


def test_auto_follows_the_measured_table(monkeypatch: pytest.MonkeyPatch) -> None:
    measured = {
        "avx512_bf16": {"ratios": {"cfnet": {"bf16": 3.0, "fp32": 2.0, "onnx": 2.5}}},
        "avx2": {"ratios": {"cfnet": {"fp32": 6.0, "onnx": 5.0}}},
    }
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    monkeypatch.setattr(speeds, "table", lambda: {"machine": "a test", "modes": measured})
    chosen = {}
    for mode in ("avx512_bf16", "avx2", "plain"):
        monkeypatch.setattr(runtime.cpu, "mode", lambda mode=mode: mode)
        chosen[mode] = choose("auto", None, "cfnet")
        assert choose("auto", None, "pcwnet") == ("bf16" if mode == "avx512_bf16" else "fp32")  # not measured
    assert chosen == {"avx512_bf16": "fp32", "avx2": "onnx", "plain": "fp32"}


def test_the_shipped_table_knows_only_networks_and_runtimes_that_there_are() -> None:
    table = speeds.table()
    assert table["machine"]
    for mode, row in table["modes"].items():
        assert mode in get_args(Mode) and row["measured"] in ("natively", "held down")
        for net, ratios in row["ratios"].items():
            assert net in ("cfnet", "pcwnet", "bts", "mffnet")
            assert {"fp32"} <= set(ratios) <= {"bf16", "fp32", "int8", "onnx"}
            assert all(ratio > 0 for ratio in ratios.values())


def test_what_cannot_be_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(DataError, match="no CUDA device"):
        choose("cuda")
    with pytest.raises(DataError, match=r"a.onnx: .* not bf16"):
        choose("bf16", Path("a.onnx"))


def test_folding_changes_nothing() -> None:
    net = trained().eval()
    with torch.inference_mode():
        plain = net(*(as_input(view) for view in images()), 32)
        features = net.features(as_input(images()[0]))
        folded = fold(net)(*(as_input(view) for view in images()), 32)
        assert torch.allclose(plain.disparity_px, folded.disparity_px, atol=1e-4)
        assert isinstance(net.features[1], torch.nn.Identity)
        assert torch.allclose(features, net.features(as_input(images()[0])), atol=1e-5)


def test_all_runtimes_have_the_same_weights() -> None:
    plain, portable = (make_ready(trained(), how).net.features for how in ("fp32", "onnx"))
    image = as_input(images()[0])
    torch.testing.assert_close(plain(image), portable(image), rtol=1e-4, atol=1e-5)
    weight = portable[0].weight
    assert weight.dtype == torch.float32 and torch.equal(weight, weight.to(torch.bfloat16).float())


def test_bf16_is_close() -> None:
    exact, rough = run(trained(), "fp32"), run(trained(), "bf16")
    assert 0 < np.quantile(np.abs(exact[0] - rough[0]), 0.99) < 1


def test_images_become_tensors() -> None:
    colour = images()[0]
    tensor = as_input(colour)
    assert tensor.shape == (1, 3, 40, 72) and tensor.dtype == torch.float32
    assert np.allclose(tensor[0, 1].numpy() * 255, colour[..., 1])
    grey = as_input(colour[..., 0])
    assert torch.equal(grey[0, 0], tensor[0, 0]) and torch.equal(grey[0, 0], grey[0, 2])


def test_onnx_equals_torch(tmp_path: Path) -> None:
    from priors.nets.export import Graph, Graphs, to_onnx

    left, right = (as_input(view) for view in images())
    exact = run(trained(), "fp32")
    ready = replace(make_ready(trained(), "onnx"), about={"net": "cfnet", "size": "m"})
    graphs = Graphs(ready)
    for a, b in zip(exact, graphs(left, right, 32), strict=True):
        assert np.allclose(a[:, :-4], b[:, :-4], atol=2e-3)  # the stand-in sees the padding on the right
    assert [graphs(left, right, largest)[0].shape for largest in (64, 96, 32)] == [(40, 72)] * 3
    assert len(graphs.graphs) == 2
    path = tmp_path / "a.onnx"
    write_bytes(path, to_onnx(ready, (64, 96), 32))
    graph = Graph(path)
    assert graph.size == (64, 96) and graph.about == {"net": "cfnet", "size": "m", "largest_px": 32}
    assert np.allclose(graph(left, right)[0][:, :-4], exact[0][:, :-4], atol=2e-3)
    with pytest.raises(DataError, match="for images up to 96x64, this one is 72x80"):
        graph(*(as_input(view) for view in images(80)))
    path.write_bytes(b"no graph")
    with pytest.raises(DataError, match=r"a.onnx: no stereo network"):
        Graph(path)


@pytest.mark.networks
@pytest.mark.skipif(not STEREO, reason="no stereo weights in priors/weights yet")
@pytest.mark.parametrize("path", STEREO, ids=lambda path: path.stem)
def test_runtimes_agree_on_real_pairs(path: Path, real_data: RealData) -> None:
    """The promise of docs/methods/stereo.md: ONNX within 0.05 px, bf16 within 0.1 px on 99 % of all pixels."""
    name, size = path.stem.split("-")
    near = []
    for sequence, number in (("06", 3), ("06", 30), ("01", 3), ("01", 30)):
        folder = real_data("kitti_odometry", "sequences", sequence)
        views = [codecs.read_image(folder / f"image_{eye}" / f"{number:06d}.png")[100:292, 200:712] for eye in (0, 1)]
        left, right = (as_input(view) for view in views)
        nets = [open_net(name, size, how) for how in ("fp32", "bf16")]
        exact, rough = (as_map(net(left, right, largest_px=96).disparity_px) for net in nets)
        near.append(np.abs(exact - rough) <= 0.1)
        from priors.nets.export import Graphs

        portable = Graphs(open_net(name, size, "onnx"))(left, right, 96)[0]
        assert np.max(np.abs(exact - portable)) <= 0.05
    assert np.mean(near) >= 0.99
