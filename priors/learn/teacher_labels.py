"""Teacher's disparity maps: a stereo network of yours runs over real pairs, to label them for training.

    python -m priors.learn.teacher_labels --peer psmnet.py --weights model.tar --data ../shared/data --out teacher/

The peer is a Python file with a network class: called with two ImageNet-normalised images (1, 3, h, w), h and w
multiples of 32, it returns the left view's disparity (1, h, w). Nothing of it becomes part of this package. Maps that
are there already are kept, so that a stopped run goes on.
"""

import importlib.util
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import torch
import tyro
from torch import nn

from eval.files import write_atomically
from priors.codecs import as_rgb
from priors.errors import DataError
from priors.geometry import mirror_columns
from priors.learn.eye_views import EyeView, Side, read_views, sequences
from priors.machine import threads
from priors.types import FloatMap, Image

MEAN, STD = np.array([0.485, 0.456, 0.406], np.float32), np.array([0.229, 0.224, 0.225], np.float32)
MULTIPLE = 32


@dataclass(frozen=True)
class TeacherConfig:
    """Write one disparity map (h, w) float32 .npy, px, for each view of each pair."""

    peer: Path
    """Python file with the network."""
    weights: Path
    """Its checkpoint, read without unpickling code."""
    data: Path
    """Folder that holds kitti_odometry."""
    out: Path
    """Folder for the maps."""
    network: str = "PSMNet"
    """Name of the class in the file."""
    sides: tuple[Side, ...] = ("left", "right")
    """Views to label; the right one as the left one of the mirrored pair."""
    every: int = 1
    """Only every n-th frame."""
    bf16: bool = False
    """Compute in bfloat16: half the time where the CPU has it; PSMNet's disparities change by 0.04 px in the median."""
    threads: int = 2
    """CPU threads."""

    def __post_init__(self) -> None:
        if self.every < 1 or self.threads < 1:
            raise DataError(f"--every and --threads: expected 1 or more, found {self.every} and {self.threads}")


def main(arguments: list[str] | None = None) -> None:
    """Label what is not labelled yet, left views first; takes the command line's arguments."""
    config = tyro.cli(TeacherConfig, args=arguments, description=__doc__)
    with threads.limited(config.threads):
        net = load(config.peer, config.network, config.weights)
        for side in config.sides:
            for sequence in sequences(config.data):
                views = (view for view in read_views(sequence) if view.side == side)
                for view in islice(views, 0, None, config.every):
                    label(net, view, config)


def label(net: nn.Module, view: EyeView, config: TeacherConfig) -> None:
    """Write the map of one view, if it is not there."""
    path = config.out / f"{view.name}.npy"
    if not path.exists():
        write_atomically(path, partial(_save, predict(net, view, bf16=config.bf16)))
        print(path, flush=True)


def load(peer: Path, name: str, weights: Path) -> nn.Module:
    """Load the network and its checkpoint; DataError where either is not what is expected."""
    spec = importlib.util.spec_from_file_location("peer", peer)
    if spec is None or spec.loader is None or not peer.is_file():
        raise DataError(f"{peer}: expected a Python file with the class {name}")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if not hasattr(module, name):
        raise DataError(f"{peer}: no class {name}: give its name with --network")
    net: nn.Module = getattr(module, name)()
    state = torch.load(weights, map_location="cpu", weights_only=True)
    state = state.get("state_dict", state)
    net.load_state_dict({key.removeprefix("module."): value for key, value in state.items()}, strict=False)
    return net.eval()


def predict(net: nn.Module, view: EyeView, *, bf16: bool = False) -> FloatMap:
    """Return the disparity (h, w), px, in the view's own pixels: a right eye's map is turned back from the mirror."""
    height, width = view.left.shape[:2]
    with torch.inference_mode(), torch.autocast("cpu", torch.bfloat16, enabled=bf16):
        map_ = net(*(_tensor(image) for image in (view.left, view.right)))[0].float().numpy()
    map_ = map_[-height:, :width]
    return mirror_columns(map_) if view.side == "right" else np.ascontiguousarray(map_)


def _tensor(image: Image) -> torch.Tensor:
    """Normalise an image and pad it at the top and on the right."""
    colour = as_rgb(image)
    values = (colour.astype(np.float32) / 255 - MEAN) / STD
    pad = (-image.shape[0] % MULTIPLE, 0), (0, -image.shape[1] % MULTIPLE), (0, 0)
    return torch.from_numpy(np.pad(values, pad).transpose(2, 0, 1).copy())[None]


def _save(map_: FloatMap, target: Path) -> None:
    with target.open("wb") as file:
        np.save(file, map_)


if __name__ == "__main__":
    try:
        main()
    except DataError as error:
        raise SystemExit(str(error)) from None
