"""PSMNet as a peer (Chang and Chen, CVPR 2018): its code and its weights are files of the user's, not the package's."""

import importlib.util
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from priors.codecs import FARTHEST_M, as_rgb
from priors.errors import DataError
from priors.geometry import convert_disparity
from priors.pairs.read import baseline, read_pair
from priors.types import Depth, Frame, Image, Input, Method

MEAN, SPREAD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
"""Of ImageNet's colours: what its authors feed."""
MULTIPLE, LEAST, MOST_DISPARITY_PX = 32, 256, 192


@dataclass(frozen=True)
class Psmnet(Method):
    """PSMNet as its authors run it: float32, ImageNet's colours, zeros at the top and the right."""

    VERSION: ClassVar[int] = 1
    code: Path = Path("psmnet.py")
    """A file that has the class PSMNet(disparities)."""
    weights: Path = Path("pretrained_model_KITTI2015.tar")
    """Its weights: a PyTorch file with `state_dict`."""

    @property
    def reads(self) -> tuple[Input, ...]:
        """Return what a frame must have."""
        return ("image", "other")

    def resolve(self, frame: Frame) -> Self:
        """Return it as it is: nothing is 'auto'."""
        return self

    def weights_digest(self) -> str:
        """Return the hash of code and weights; DataError where one cannot be read."""
        try:
            return sha256(self.code.read_bytes() + self.weights.read_bytes()).hexdigest()
        except OSError as error:
            raise DataError(f"{error.filename}: cannot be read ({error.strerror}): see --psmnet") from error

    def __call__(self, frame: Frame) -> Depth:
        """Make the dense map (height, width), metres; no confidence."""
        import torch

        net = _load(self.code, self.weights, tuple(path.stat().st_mtime_ns for path in (self.code, self.weights)))
        pair, fx_baseline = read_pair(frame), frame.camera.fx * baseline(frame)
        height, width = frame.camera.size
        with torch.inference_mode():
            views = (torch.from_numpy(_view(image)) for image in (pair.left, pair.right))
            disparity_px = net(*views)[0].numpy()[-height:, :width].astype(np.float32)
        least_px = np.float32(fx_baseline / FARTHEST_M)
        depth_m = convert_disparity(np.maximum(disparity_px, least_px), frame.camera.fx, baseline(frame))
        return Depth(pair.restore(depth_m))


def _view(image: Image) -> npt.NDArray[np.float32]:
    """Return an image as the network takes it, (1, 3, h, w)."""
    scaled = ((as_rgb(image) / 255.0 - MEAN) / SPREAD).astype(np.float32)
    height, width = scaled.shape[:2]
    high, wide = (max(LEAST, -(-side // MULTIPLE) * MULTIPLE) for side in (height, width))
    padded = np.pad(scaled, ((high - height, 0), (0, wide - width), (0, 0)))
    return np.ascontiguousarray(padded.transpose(2, 0, 1))[None]


@lru_cache(maxsize=1)
def _load(code: Path, weights: Path, _times: tuple[int, ...]) -> Any:
    """Load the network once a process, and again where a file has changed; DataError where they are something else."""
    import torch

    try:
        spec = importlib.util.spec_from_file_location("peer_psmnet", code)
        if spec is None or spec.loader is None:
            raise ImportError("it is no Python file")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        net = module.PSMNet(MOST_DISPARITY_PX).eval()
    except Exception as error:  # whatever the user's file does
        raise DataError(f"{code}: cannot be loaded ({error}): expected a file with the class PSMNet") from error
    try:
        state = torch.load(weights, map_location="cpu", weights_only=True)["state_dict"]
        net.load_state_dict({key.removeprefix("module."): value for key, value in state.items()})
    except Exception as error:  # pickle has many names for a damaged file
        reason = str(error).splitlines()[0]
        raise DataError(f"{weights}: cannot be loaded ({reason}): expected PSMNet's weights") from error
    return net
