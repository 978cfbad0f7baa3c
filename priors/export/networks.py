"""Networks as ONNX files. Each is compared with PyTorch before it is written, and a text file beside describes it.

A file is for one size of image, since all shapes are constants; a stereo network's is for one range of disparities too,
and its size is rounded up to multiples of 32 (pad smaller pairs at the right and the bottom by their last pixels).
"""

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from eval.files import write_bytes
from priors.cache import Prior
from priors.errors import DataError, UsageError, expect, expect_between

if TYPE_CHECKING:  # keeps PyTorch out of --help
    from torch import Tensor

    from priors.nets.runtime import Ready

STEREO = ("cfnet", "pcwnet")
STEP_PX = 32
LARGEST_SIDE = 16384
MOST_DIFFERENT = 0.01
"""Largest median difference of an output from PyTorch's, as a share of its median size: more is a fault."""
PADDED = "A smaller pair is padded at its right and its bottom by its last pixels; cut the outputs to its size."
Array = npt.NDArray[np.float32]

VALUES = {
    "left": "the pair's left image, RGB in [0, 1]",
    "right": "the pair's right image, RGB in [0, 1]",
    "disparity_px": "disparity of the left image, pixels",
    "sigma_px": "expected error of the disparity, pixels",
    "doubt": "logit of an error above 1 px, before its calibration: confidence = sigmoid(-doubt)",
    "image": "image, RGB in [0, 1]",
    "K": "camera matrix, pixels; the centre of the top-left pixel is (0, 0)",
    "depth_m": "distance along the camera's z axis, metres",
    "sky_logit": "logit that there is no surface",
    "log_scale": "logarithm of the expected error of the depth's logarithm",
    "coarse_m": "depth at a lower resolution, metres",
    "fill_m": "first guess of the depth at each pixel, metres",
    "certain": "how certain the first guess is, in [0, 1]",
    "sparse_m": "measured depth, metres, 0 where there is none",
}
"""What each input and output is."""


@dataclass(frozen=True)
class NetworkConfig:
    """Which network, and for which images."""

    net: str | None = None
    """Network to export, for example cfnet-s; default: the one that made PRIOR."""
    weights: Path | None = None
    """Your own weights (.safetensors) instead of those that ship; their header says which network they are of."""
    image_size: str | None = None
    """WIDTHxHEIGHT of the images, pixels; default: PRIOR's, else 1242x375."""
    max_disparity: int = 192
    """Largest disparity that a stereo network searches, pixels; rounded up to a multiple of 32."""

    def __post_init__(self) -> None:
        expect_between(1, self.max_disparity, LARGEST_SIDE, "--max-disparity")
        parse_size(self.image_size)
        named = self.net is None or re.fullmatch(r"\w+-[sml]", self.net) is not None
        expect(named, "--net", repr(self.net), "a network and its size, for example cfnet-s")
        expect(self.net is None or self.weights is None, "--net", self.net, "--net or --weights, not both")


@dataclass(frozen=True)
class Exported:
    """A network for one size of image."""

    net: str
    """Its module in priors/nets."""
    size: str
    """s, m or l."""
    weights: Path | None
    """The user's file; None: what ships."""
    image: tuple[int, int]
    """(height, width), pixels; multiples of 32 for a stereo network."""
    largest_px: int
    """Disparities that a stereo network searches."""

    @property
    def name(self) -> str:
        """What its file is called, without the ending."""
        return f"{self.net}-{self.size}-{self.image[1]}x{self.image[0]}"


def parse_size(text: str | None) -> tuple[int, int] | None:
    """Return (height, width) of WIDTHxHEIGHT; None for None. UsageError where it is none."""
    if text is None:
        return None
    sides = text.split("x")
    whole = len(sides) == 2 and all(side.isascii() and side.isdigit() for side in sides)
    if not whole or not all(STEP_PX <= int(side) <= LARGEST_SIDE for side in sides):
        told = f"WIDTHxHEIGHT in pixels, each from {STEP_PX} to {LARGEST_SIDE}, for example 1242x375"
        raise UsageError(f"--image-size {text}: expected {told}")
    return int(sides[1]), int(sides[0])


def decide(config: NetworkConfig, prior: Prior | None) -> Exported:
    """Decide which network goes out.

    Args:
        config: what was asked for.
        prior: whose network and image size are taken where the config names none; None: nothing is.

    Raises:
        UsageError: neither names a network, or the name is none.
        DataError: the prior was made without a network, or by one that was not kept.
    """
    from priors.nets import weights

    if config.weights is not None:
        about = weights.read_about(weights.find("", "", config.weights))
        net, size = str(about.get("net")), str(about.get("size"))
    elif config.net is not None:
        net, _, size = config.net.rpartition("-")
    elif prior is not None:
        return _of_prior(config, prior)
    else:
        raise UsageError("--to onnx: name a network (--net cfnet-s), a file of weights, or a prior that one made")
    there = sorted(file.stem for file in weights.FOLDER.glob("*.safetensors"))
    if net not in {name.rpartition("-")[0] for name in there} or size not in ("s", "m", "l"):
        asked = f"--net {config.net}" if config.weights is None else f"{config.weights}: {net}-{size}"
        raise UsageError(f"{asked}: there is no such network: choose one of {', '.join(there)}")
    return _sized(config, net, size, config.weights, parse_size(config.image_size) or (375, 1242))


def write(path: Path, exported: Exported) -> list[str]:
    """Write the ONNX file and a description beside it, NAME.onnx.txt; returns what to tell the user.

    Raises:
        DataError: the weights are missing or damaged, or onnxruntime does not say what PyTorch says.
        OSError: it cannot be written.
    """
    from priors.nets import graphs
    from priors.nets.runtime import open_net

    ready = open_net(exported.net, exported.size, "onnx", exported.weights)
    inputs, data = _graph(ready, exported)
    data = _described(data)
    session = graphs.open_session(data)
    names = [value.name for value in session.get_outputs()]
    found = dict(zip(names, session.run(names, inputs), strict=True))
    differences = compare(found, _by_torch(ready, exported, inputs))
    write_bytes(path, data)
    write_bytes(path.with_name(f"{path.name}.txt"), _about(exported, session, differences).encode())
    told = ", ".join(f"{name} {value:.2g}" for name, value in differences.items())
    return [f"{exported.name}: {path}", f"largest difference of onnxruntime from PyTorch: {told}"]


def compare(found: dict[str, Array], wanted: dict[str, Array]) -> dict[str, float]:
    """Return the largest difference of each output; DataError where one is no rounding."""
    largest = {}
    for name, values in found.items():
        difference = np.abs(values - wanted[name])
        largest[name] = float(difference.max())
        if not np.median(difference) <= MOST_DIFFERENT * max(float(np.median(np.abs(wanted[name]))), 1e-3):
            raise DataError(f"{name}: onnxruntime is {np.median(difference):.3g} off PyTorch: not written")
    return largest


def _of_prior(config: NetworkConfig, prior: Prior) -> Exported:
    """Return the network that made a prior, for images of its size."""
    made = prior.manifest.get("config", {})
    net = {"mono": "bts"}.get(prior.method, str(made.get("model")))
    if prior.method not in ("stereo", "completion", "mono") or net in ("classical", "None"):
        raise DataError(f"{prior.folder}: no network made it: name one, for example --net cfnet-s")
    if made.get("adapt", "none") != "none" or str(made.get("weights") or "").endswith(".onnx"):
        why = "adapted to its drive and not kept" if made.get("adapt", "none") != "none" else "an ONNX file already"
        raise DataError(f"{prior.folder}: its network was {why}: name one, for example --net {net}-{made.get('size')}")
    if made.get("weights") is not None:
        raise DataError(f"{prior.folder}: it was made with weights {made['weights']}: name their file by --weights")
    size = parse_size(config.image_size) or tuple(prior.manifest.get("camera", {}).get("size", (375, 1242)))
    return _sized(config, net, str(made.get("size", "s")), None, (int(size[0]), int(size[1])))


def _sized(config: NetworkConfig, net: str, size: str, weights: Path | None, image: tuple[int, int]) -> Exported:
    largest_px = -(-config.max_disparity // STEP_PX) * STEP_PX
    if net in STEREO:
        image = (-(-image[0] // STEP_PX) * STEP_PX, -(-image[1] // STEP_PX) * STEP_PX)
    return Exported(net, size, weights, image, largest_px)


def _graph(ready: "Ready", exported: Exported) -> tuple[dict[str, Array], bytes]:
    """Return inputs to try the graph on, by their names, and its bytes."""
    import torch

    from priors.nets import graphs
    from priors.nets.export import to_onnx

    height, width = exported.image
    if exported.net in STEREO:
        left, right = _pair(height, width)
        return {"left": left, "right": right}, to_onnx(ready, exported.image, exported.largest_px)
    inputs = _scene(height, width, graphs.FORMS[exported.net].inputs)
    return inputs, graphs.to_onnx(ready, exported.net, tuple(map(torch.from_numpy, inputs.values())))


def _scene(height: int, width: int, names: tuple[str, ...]) -> dict[str, Array]:
    """Return a road to a horizon as networks of one image take it: its depth is known in part, with an error."""
    rng = np.random.default_rng(0)
    depth_m = np.tile(np.linspace(80, 5, height, dtype=np.float32)[:, None], (1, width))[None]
    K = np.array([[[0.6 * width, 0, width / 2], [0, 0.6 * width, height / 2], [0, 0, 1]]], dtype=np.float32)
    known = rng.random(depth_m.shape) < 0.05
    values = {
        "image": np.clip(rng.normal(0.4, 0.1, (1, 3, height, width)) + 2 / depth_m, 0, 1),
        "K": K,
        "fill_m": depth_m * rng.normal(1, 0.05, depth_m.shape),
        "certain": rng.random(depth_m.shape),
        "sparse_m": np.where(known, depth_m, 0),
    }
    return {name: np.ascontiguousarray(values[name], dtype=np.float32) for name in names}


def _pair(height: int, width: int, shift_px: int = 12) -> tuple[Array, Array]:
    """Return a pair (1, 3, height, width) each whose right image is the left one moved: there is one right answer."""
    texture = np.random.default_rng(0).random((height, width + shift_px, 3), dtype=np.float32)
    wide = np.moveaxis(texture, 2, 0)[None]
    return np.ascontiguousarray(wide[..., :width]), np.ascontiguousarray(wide[..., shift_px:])


def _by_torch(ready: "Ready", exported: Exported, inputs: dict[str, Array]) -> dict[str, Array]:
    """Return what PyTorch says of the inputs, by the outputs' names."""
    import torch

    from priors.nets import graphs
    from priors.nets.export import OUTPUTS

    given: list[Tensor] = [torch.from_numpy(value) for value in inputs.values()]
    stereo = exported.net in STEREO
    result = ready(*given, largest_px=exported.largest_px) if stereo else ready(*given)
    names = OUTPUTS if stereo else graphs.FORMS[exported.net].outputs
    return {name: getattr(result, name).float().numpy() for name in names}


def _described(data: bytes) -> bytes:
    """Return an ONNX file whose inputs and outputs say what they are."""
    import onnx

    model = onnx.load_from_string(data)
    for value in (*model.graph.input, *model.graph.output):
        value.doc_string = VALUES[value.name]
    model.producer_name = "roadprior"
    return bytes(model.SerializeToString())


def _about(exported: Exported, session: Any, differences: dict[str, float]) -> str:
    """Describe a file's inputs and outputs."""
    lines = [f"Written by roadprior: {exported.name}, float32."]
    if exported.net in STEREO:
        lines += [f"It searches disparities from 0 to {exported.largest_px - 1} px.", PADDED]
    for what, values in (("input", session.get_inputs()), ("output", session.get_outputs())):
        lines += [f"{what:<6} {value.name} {json.dumps(value.shape)}: {VALUES[value.name]}" for value in values]
    lines += [f"Largest difference from PyTorch, {name}: {value:.3g}" for name, value in differences.items()]
    return "".join(f"{line}\n" for line in lines)
