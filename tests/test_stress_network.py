"""`priors stress --network`: a user's network on extreme images, judged by what is stated of every map."""

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_mono_foreign import brightness_net

from cli.priors import PROGRAM
from priors.bench.entrants import network
from priors.errors import DataError
from priors.stress.network import INPUTS, try_network
from priors.types import Depth, Frame, Input, Method

pytestmark = pytest.mark.stress
SIZE = (24, 40)


def test_a_network_that_answers_brightness(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Metric depth: black has no depth, which is as stated; a relative one is aligned, or refused where it is flat."""
    path = brightness_net(tmp_path / "mine.onnx")
    path.with_suffix(".toml").write_text('output = "metric-depth"\n')
    assert PROGRAM.run(["stress", "--network", str(path), "--image-size", "64x48"]) == 0
    said = capsys.readouterr().out
    assert f"{len(INPUTS)} inputs, 0 not as stated" in said and "black               ok     no depth" in said
    path.with_suffix(".toml").write_text('output = "disparity"\n')
    assert PROGRAM.run(["stress", "--network", str(path), "--json"]) == 0
    (tried,) = json.loads(capsys.readouterr().out).values()
    assert [each["input"] for each in tried] == [name for name, _ in INPUTS]


@dataclass(frozen=True)
class Faulty(Method):
    """A method with one fault."""

    fault: str = ""

    @property
    def reads(self) -> tuple[Input, ...]:
        return ("image",)

    def resolve(self, frame: Frame) -> Any:
        return self

    def __call__(self, frame: Frame) -> Depth:
        size = frame.camera.size
        depth = Depth(np.full(size, 5, np.float32), np.full(size, 0.5, np.float32))
        depth.depth_m[0, 0], depth.trust()[0, 0] = 0, 0
        if self.fault == "other bits when asked again":
            depth.depth_m[1, 1] = np.random.default_rng().uniform(1, 9)
        changed = {
            "depths that are not finite": {"depth_m": depth.depth_m * np.float32(np.nan)},
            "depths below 0": {"depth_m": -depth.depth_m},
            "a confidence that is not from 0 to 1": {"confidence": 3 * depth.trust()},
            "confidence where there is no depth": {"confidence": depth.trust() + np.float32(0.1)},
            "the map holds float64, not float32": {"depth_m": depth.depth_m.astype(np.float64)},
            "the map is (12, 40), the image (24, 40)": {"depth_m": depth.depth_m[::2], "confidence": None},
            "no depth anywhere": {"depth_m": 0 * depth.depth_m, "confidence": None},
        }
        if self.fault == "refused" and frame.image().std() == 0:
            raise DataError("nothing to see")
        return replace(depth, **changed.get(self.fault, {}))


FAULTS = (
    "depths that are not finite",
    "depths below 0",
    "a confidence that is not from 0 to 1",
    "confidence where there is no depth",
    "the map holds float64, not float32",
    "the map is (12, 40), the image (24, 40)",
    "no depth anywhere",
    "other bits when asked again",
)


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_seen(fault: str) -> None:
    assert try_network(Faulty(fault), SIZE)[0].fault == fault


def test_a_good_one_and_one_that_refuses() -> None:
    assert not any(each.fault or each.told for each in try_network(Faulty(), SIZE))
    refused = [each.input for each in try_network(Faulty("refused"), SIZE) if each.told]
    assert refused == ["black", "white", "constant grey"]


def test_wrong_flags_and_files_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, code, told in (
        (["--network", str(tmp_path / "no.onnx")], 1, "no.onnx: no such file: name a network's .onnx or .safetensors"),
        (["--image-size", "64x48"], 2, "--image-size: read with --network: add it, or leave --image-size out"),
        (["--network", "a.onnx", "--modes"], 2, "--modes: of the routines: leave out --modes or --network"),
        (["--network", "a.onnx", "--image-size", "big"], 2, "--image-size big: expected WIDTHxHEIGHT"),
    ):
        assert PROGRAM.run(["stress", *words]) == code
        assert told in capsys.readouterr().err
    (tmp_path / "damaged.onnx").write_bytes(b"no graph")
    with pytest.raises(DataError, match=r"damaged\.onnx: no stereo graph of ours"):
        network(tmp_path / "damaged.onnx")


@pytest.mark.slow
@pytest.mark.parametrize("net", ["cfnet-s", "bts-m"])
def test_our_own_are_as_stated(net: str) -> None:
    weights = Path(__file__).resolve().parents[1] / "priors" / "weights" / f"{net}.safetensors"
    assert [
        f"{each.input}: {each.fault}" for each in try_network(network(weights).method, (64, 208)) if each.fault
    ] == []
