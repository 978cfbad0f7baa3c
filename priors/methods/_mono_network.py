"""Our single-image network: run on a frame, and adapted to a drive."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import nn

from priors.adapt.finetune import AdaptConfig, fine_tune
from priors.cache.learned import WatchedDrive, why_learned_stale
from priors.cache.sources import Digests
from priors.errors import DataError
from priors.geometry import resize
from priors.keys import key_of
from priors.methods._mono_estimator import Prediction
from priors.methods._mono_size import brought, scaled
from priors.methods._mono_supervision import PlannedSupervision
from priors.methods._network import Network
from priors.nets import runtime, weights
from priors.owner import claim
from priors.records import original, record
from priors.types import Camera, Drive, FloatMap, Image

if TYPE_CHECKING:  # onnxruntime's half is loaded where it is asked for
    from priors.nets.graphs import Portable
    from priors.nets.runtime import Ready

POLL_S = 0.3
"""How often to look whether another build has adapted the weights."""
MADE_OF = "made_of"
"""Entry of the adapted weights' header: the files that they learned from, by frame (priors/cache/learned.py)."""
APART = 0.5
"""Share of the looks' difference that adds to the error to expect."""
VERSION = 1
"""Of how adapting works: part of the adapted weights' key."""


def estimate(net: "Ready | Portable", image: Image, camera: Camera, shares: Sequence[float] = (1.0,)) -> Prediction:
    """Run the network on an image: depth in metres, 0 in the sky, and the expected error of its logarithm.

    It looks at the image once a share: at its sides times that share. The answer has the image's size all the same. Of
    several looks it is the mean in the logarithm, and the more they differ, the larger is the error to expect.
    """
    seen = [_look(net, image, camera, share) for share in shares]
    log_inverse, sky_logit, log_error = (np.mean(maps, axis=0) for maps in zip(*seen, strict=True))
    apart = np.ptp([look[0] for look in seen], axis=0)
    depth_m = np.where(sky_logit > 0, np.float32(0), np.exp(-log_inverse))
    return Prediction(depth_m, np.exp(log_error) + np.float32(APART) * apart)


def _look(net: "Ready | Portable", image: Image, camera: Camera, share: float) -> tuple[FloatMap, FloatMap, FloatMap]:
    """Return the logarithm of inverse depth, the sky's logit, and the logarithm of the error (height, width)."""
    seen = image if share == 1 else scaled(image, share)
    out = net(runtime.as_input(seen), torch.from_numpy(resize(camera, seen.shape[:2]).K).float()[None])
    with torch.inference_mode():  # inverse depth is what changes evenly between pixels
        maps = (runtime.as_map(map_) for map_ in (1 / out.depth_m, out.sky_logit, out.log_scale))
        inverse, sky_logit, log_error = maps if share == 1 else (brought(map_, camera.size) for map_ in maps)
    return np.log(inverse), sky_logit, log_error


def adapted_weights(
    drive: Drive,
    planned: PlannedSupervision,
    network: Network,
    config: AdaptConfig,
    folder: Path,
    on_note: Callable[[str], None],
) -> Path:
    """Return weights adapted to a drive: from the folder where they are there, else adapted now and kept there.

    Args:
        drive: the drive.
        planned: what its frames teach.
        network: the network to start from. What will run it decides what adapts it: bf16 also trains in bf16.
        config: how long to adapt.
        folder: where adapted weights are kept; the name is a hash of all that decides them.
        on_note: told what is going on, a line at a time.
    """
    decides = {
        "version": VERSION,
        "start": network.digest(),
        "size": network.size,
        "drive": drive.fingerprint(),
        "frames": planned.frames,
        "known": planned.decides,
        "config": original(AdaptConfig, record(config)),
    }
    path = folder / f"mono-{key_of(decides)}.safetensors"
    with _in_hand(path, on_note):
        if _are_as_before(path, drive, on_note):
            return path
        adapted = _adapt(planned, network, config, on_note)
        if not all(bool(torch.isfinite(p).all()) for p in adapted.parameters()):
            raise DataError("mono: adapting diverged: choose --mono.adapt none, or other frames")
        adapting = {name: value for name, value in decides.items() if name != "known"}
        about = {"net": network.model, "size": network.size, "adapted": adapting}
        if isinstance(drive, WatchedDrive):
            about[MADE_OF] = drive.sources(Digests())
        weights.write(path, adapted, about)
    return path


def _are_as_before(path: Path, drive: Drive, on_note: Callable[[str], None]) -> bool:
    """Tell whether there are adapted weights, of files that hold the same today; a watched drive is told of them."""
    if not path.is_file():
        return False
    read = weights.read_about(path).get(MADE_OF)
    reason = why_learned_stale(read, drive.drive if isinstance(drive, WatchedDrive) else drive, Digests())
    if reason is not None:
        on_note(f"mono: adapting again: {reason}")
        return False
    if isinstance(drive, WatchedDrive) and isinstance(read, dict):
        drive.learned_before(read)
    on_note(f"mono: weights adapted before: {path}")
    return True


@contextmanager
def _in_hand(path: Path, on_note: Callable[[str], None]) -> Iterator[None]:
    """Let one build at a time adapt weights; the others wait for its file, or for its end."""
    if path.is_file():  # nothing to be claimed, perhaps in a cache that cannot be written
        yield
        return
    claimed = path.with_suffix(".claim")
    held = claim.take(claimed)
    if held is None:
        on_note(f"mono: {claim.owner_of(claimed) or 'another build'} adapts these weights: waiting for them")
    while held is None:
        time.sleep(POLL_S)
        held = claim.take(claimed)
    with held:
        yield


def _adapt(
    planned: PlannedSupervision, network: Network, config: AdaptConfig, on_note: Callable[[str], None]
) -> nn.Module:
    """Read what the frames teach and fine-tune the network on it."""
    chosen = network.decide()
    bf16 = chosen in ("bf16", "cuda")
    on_note(f"mono: reading {len(planned.frames)} training frames with their {planned.what}")
    net = runtime.create(network.model, network.size)
    weights.fill(net, weights.load(network.file()), network.model, network.size)
    net = net.to("cuda" if chosen == "cuda" else "cpu").eval()
    supervision = planned.read(net, bf16)

    def tell(done: float, error: float) -> None:
        on_note(f"mono: adapting, {done:.0%}: {supervision.measures} {error:.3f}")

    return fine_tune(net, supervision, config, tell, bf16=bf16)
