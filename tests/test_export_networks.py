"""Networks as ONNX files: what a stranger's onnxruntime says of them is what PyTorch says."""

import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from test_nets_graphs import network

from priors import cache
from priors.errors import DataError, UsageError
from priors.export import networks
from priors.export.networks import NetworkConfig
from priors.nets import graphs, weights
from priors.nets.export import Graph
from priors.nets.runtime import open_net

pytestmark = pytest.mark.datasets


@pytest.mark.parametrize(("name", "size"), [("bts", "s"), ("mffnet", "s")])
def test_a_stranger_gets_what_torch_says(name: str, size: str, tmp_path: Path) -> None:
    file, out = tmp_path / "own.safetensors", tmp_path / "own.onnx"
    weights.write(file, network(name, size), {"net": name, "size": size})
    exported = networks.decide(NetworkConfig(weights=file, image_size="70x45"), None)
    assert exported.name == f"{name}-{size}-70x45"
    lines = networks.write(out, exported)
    session = onnxruntime.InferenceSession(str(out), providers=["CPUExecutionProvider"])
    form = graphs.FORMS[name]
    assert [value.name for value in session.get_inputs()] == list(form.inputs)
    assert session.get_inputs()[0].shape == [1, 3, 45, 70]
    given = form.examples(45, 70)
    found = session.run(list(form.outputs), {n: v.numpy() for n, v in zip(form.inputs, given, strict=True)})
    wanted = open_net(name, size, "onnx", file)(*given)
    for field, values in zip(form.outputs, found, strict=True):
        torch.testing.assert_close(torch.from_numpy(values), getattr(wanted, field), atol=1e-3, rtol=2e-3)
    about = (tmp_path / "own.onnx.txt").read_text()
    model = onnx.load(out)
    for value in (*model.graph.input, *model.graph.output):
        assert value.doc_string == networks.VALUES[value.name] and f" {value.name} [" in about
    assert json.loads(session.get_modelmeta().custom_metadata_map["roadprior"])["net"] == name
    assert "largest difference of onnxruntime from PyTorch: depth_m" in lines[1]


def test_a_stereo_network_goes_out_and_comes_back(tmp_path: Path) -> None:
    exported = networks.decide(NetworkConfig(net="cfnet-s", image_size="90x60", max_disparity=40), None)
    assert (exported.image, exported.largest_px) == ((64, 96), 64)
    networks.write(tmp_path / "a.onnx", exported)
    left, right = (torch.from_numpy(view) for view in networks._pair(64, 96))
    disparity_px, _, _ = Graph(tmp_path / "a.onnx")(left, right)
    assert np.median(np.abs(disparity_px[:, 20:] - 12)) < 0.5, "the pair's right image is moved by 12 px"
    assert "from 0 to 63 px" in (tmp_path / "a.onnx.txt").read_text()


def test_a_graph_that_says_something_else_is_not_written() -> None:
    wanted = {"depth_m": np.linspace(1, 50, 100, dtype=np.float32)}
    assert networks.compare({"depth_m": wanted["depth_m"] + np.float32(1e-3)}, wanted)["depth_m"] < 2e-3
    for wrong in (wanted["depth_m"] * np.float32(1.1), wanted["depth_m"][::-1], wanted["depth_m"] * np.float32("nan")):
        with pytest.raises(DataError, match=r"depth_m: onnxruntime is .* off PyTorch"):
            networks.compare({"depth_m": wrong}, wanted)


def prior(folder: Path, method: str, config: dict) -> cache.Prior:
    manifest = {"format": 2, "drive": {"path": "/nowhere"}, "config": config, "camera": {"size": [45, 70]}}
    return cache.load(cache.create(folder / "drive" / f"{method}-aa", manifest).folder)


def test_a_priors_network_is_the_one_that_made_it(tmp_path: Path) -> None:
    mono = networks.decide(NetworkConfig(), prior(tmp_path, "mono", {"size": "m", "adapt": "none", "weights": None}))
    assert (mono.net, mono.size, mono.image) == ("bts", "m", (45, 70))
    stereo = prior(tmp_path, "stereo", {"model": "pcwnet", "size": "s", "weights": None})
    assert networks.decide(NetworkConfig(image_size="100x50"), stereo).name == "pcwnet-s-128x64"


@pytest.mark.parametrize(
    ("method", "config", "says"),
    [
        ("stereo", {"model": "classical"}, "no network made it"),
        ("lidar", {"sweeps": 11}, "no network made it"),
        ("mono", {"size": "m", "adapt": "lidar"}, "adapted to its drive"),
        ("mono", {"size": "m", "adapt": "none", "weights": "depth.onnx"}, "an ONNX file already"),
        ("stereo", {"model": "cfnet", "size": "s", "weights": "mine.safetensors"}, "name their file by --weights"),
    ],
)
def test_a_prior_without_a_network_of_ours_is_told(tmp_path: Path, method: str, config: dict, says: str) -> None:
    with pytest.raises(DataError, match=says):
        networks.decide(NetworkConfig(), prior(tmp_path, method, config))


@pytest.mark.parametrize("size", ["1242", "axb", "10x10", "100x", "1242x375x3", "99999x100", "-100x100", "²²x100"])
def test_a_size_that_is_none_is_refused(size: str) -> None:
    with pytest.raises(UsageError, match=r"--image-size .*WIDTHxHEIGHT"):
        NetworkConfig(image_size=size)


def test_a_network_that_is_none_is_refused(tmp_path: Path) -> None:
    for name in ("foo", "cfnet", "cfnet-xl", ""):
        with pytest.raises(UsageError, match="a network and its size, for example cfnet-s"):
            NetworkConfig(net=name)
    with pytest.raises(UsageError, match="choose one of bts-m, cfnet-s"):
        networks.decide(NetworkConfig(net="foo-s"), None)
    with pytest.raises(UsageError, match="name a network"):
        networks.decide(NetworkConfig(), None)
    with pytest.raises(DataError, match="no such file of weights"):
        networks.decide(NetworkConfig(weights=tmp_path / "none.safetensors"), None)
    with pytest.raises(DataError, match="no weights for cfnet in size l"):
        networks.write(tmp_path / "a.onnx", networks.decide(NetworkConfig(net="cfnet-l"), None))
