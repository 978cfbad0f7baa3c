"""Our single-image network: loaded, run on a frame, and adapted to a drive."""

from collections.abc import Callable
from pathlib import Path

import torch

from priors.adapt.finetune import AdaptConfig, fine_tune
from priors.errors import DataError
from priors.keys import key_of
from priors.methods._mono_supervision import Lesson
from priors.nets import runtime, weights
from priors.nets.graphs import Portable, open_portable
from priors.nets.runtime import Ready, Runtime
from priors.records import original, record
from priors.types import Camera, Drive, FloatMap, Image

NAME = "bts"
VERSION = 1
"""Of how adapting works: part of the adapted weights' key."""


def estimate(ready: Ready | Portable, image: Image, camera: Camera) -> tuple[FloatMap, FloatMap]:
    """Run the network on an image.

    Returns:
        depth_m (height, width), 0 in the sky, and the expected error of its logarithm.
    """
    out = ready(runtime.as_input(image), torch.from_numpy(camera.K).float()[None])
    with torch.inference_mode():
        depth_m = torch.where(out.sky_logit > 0, 0.0, out.depth_m)
        return runtime.as_map(depth_m), runtime.as_map(torch.exp(out.log_scale))


def open_network(size: str, chosen: Runtime, file: Path | None) -> Ready | Portable:
    """Load the network, once a process; DataError where its weights are missing or damaged."""
    if chosen == "onnx":
        return open_portable(NAME, size, file)
    return runtime.open_net(NAME, size, chosen, file)


def adapted_weights(
    drive: Drive,
    lesson: Lesson,
    start: Path,
    size: str,
    config: AdaptConfig,
    folder: Path,
    on_note: Callable[[str], None],
    chosen: Runtime,
) -> Path:
    """Return weights adapted to a drive: from the folder where they are there, else adapted now and kept there.

    Args:
        drive: the drive.
        lesson: what its frames teach.
        start: weights to start from.
        size: of the network.
        config: how long to adapt.
        folder: where adapted weights are kept; the name is a hash of all that decides them.
        on_note: told what is going on, a line at a time.
        chosen: the runtime of the inference to come: bf16 also trains in bf16.
    """
    decides = {
        "version": VERSION,
        "start": weights.digest(start),
        "size": size,
        "drive": drive.fingerprint(),
        "frames": lesson.frames,
        "known": lesson.decides,
        "config": original(AdaptConfig, record(config)),
    }
    path = folder / f"mono-{key_of(decides)}.safetensors"
    if path.is_file():
        on_note(f"mono: weights adapted before: {path}")
        return path
    bf16 = chosen in ("bf16", "cuda")
    on_note(f"mono: reading {len(lesson.frames)} training frames with their {lesson.what}")
    net = runtime.create(NAME, size)
    weights.fill(net, weights.load(start), NAME, size)
    net = net.to("cuda" if chosen == "cuda" else "cpu").eval()
    supervision = lesson.read(net, bf16)

    def tell(done: float, error: float) -> None:
        on_note(f"mono: adapting, {done:.0%}: {supervision.measures} {error:.3f}")

    adapted = fine_tune(net, supervision, config, tell, bf16)
    if not all(bool(torch.isfinite(p).all()) for p in adapted.parameters()):
        raise DataError("mono: adapting diverged: choose --mono.adapt none, or other frames")
    if not path.is_file():  # another machine of this build may have been faster: all use the same
        about = {"net": NAME, "size": size, "adapted": {k: v for k, v in decides.items() if k != "known"}}
        weights.write(path, adapted, about)
    return path
