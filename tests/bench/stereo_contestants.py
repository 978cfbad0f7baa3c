"""Who takes part in bench_networks.py: OpenCV's matcher, PSMNet, and every stereo preset of ours that has weights."""

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from priors.codecs import as_grey
from priors.drives._rigs import KITTI
from priors.geometry import convert_disparity
from priors.methods.stereo import Stereo
from priors.pairs.matching import halve
from priors.pairs.rectification import NONE, RectificationError, usual_error
from priors.types import Depth, Frame

MEAN, SPREAD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)


@dataclass(frozen=True)
class Contestant:
    """A way to make depth from a pair."""

    name: str
    run: Callable[[Frame], Depth]
    family: int
    """Dots of one family are joined in the plot."""
    once: bool = False
    """So slow that one timing has to do."""


def contestants(
    folder: Path, runtimes: list[str], peer: Path | None = None, peer_weights: Path | None = None
) -> list[Contestant]:
    """List them, all from the images alone; ours with the weights in a folder, the peers as they are."""
    found = [Contestant("SGBM full", sgbm, 0), Contestant("SGBM half", sgbm_half, 0)]
    found.append(Contestant("classical", Stereo(offset_px=NONE.offset_px), 1))
    for family, model in enumerate(("cfnet", "pcwnet"), start=2):
        for size in ("s", "m", "l"):
            file = folder / f"{model}-{size}.safetensors"
            if file.is_file():
                found += [
                    Contestant(f"{model}-{size} {runtime}", _ours(model, size, runtime, file), family)
                    for runtime in runtimes
                ]
    if peer is not None and peer_weights is not None:
        found.append(Contestant("PSMNet", lambda frame: psmnet(frame, peer, peer_weights), 4, once=True))
    return found


def _ours(model: Any, size: Any, runtime: Any, file: Path) -> Stereo:
    return Stereo(model=model, size=size, runtime=runtime, weights=file, offset_px=NONE.offset_px)


def moved(contestant: Contestant, frame: Frame) -> dict[str, Contestant]:
    """Return a matcher with KITTI's usual offset and with the one measured on a frame; PSMNet has learned KITTI's."""
    run, usual = contestant.run, usual_error(KITTI, frame.camera)
    if contestant.once:
        return {}
    if isinstance(run, Stereo):
        runs: dict[str, Any] = {
            "usual": replace(run, offset_px=usual.offset_px, scale=usual.scale),
            "measured": replace(run, offset_px=None, scale=None).resolve(frame),
        }
    else:
        measured = Stereo().resolve(frame).rectification
        runs = {"usual": partial(run, error=usual), "measured": partial(run, error=measured)}
    return {kind: replace(contestant, run=run) for kind, run in runs.items()}


def sgbm(frame: Frame, error: RectificationError = NONE) -> Depth:
    """OpenCV's 3-way matcher at 192 disparities, grey; what it leaves out is left out."""
    return _depth(frame, _match(as_grey(frame.image()), as_grey(frame.other()), 192), error)


def sgbm_half(frame: Frame, error: RectificationError = NONE) -> Depth:
    """The same at half the size, 96 disparities; the result is doubled to full size."""
    image, other = halve(as_grey(frame.image())), halve(as_grey(frame.other()))
    height, width = frame.camera.size
    half = _match(image, other, 96)
    doubled = 2 * cv2.resize(half, (2 * half.shape[1], 2 * half.shape[0]), interpolation=0)
    return _depth(frame, doubled[:height, :width], error)


def _match(image: Any, other: Any, count: int) -> Any:
    matcher = cv2.StereoSGBM.create(0, count, 3, 72, 288, 1, 63, 10, 100, 2, cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    return np.maximum(matcher.compute(image, other).astype(np.float32) / 16, 0)


def _depth(frame: Frame, matched_px: Any, error: RectificationError = NONE) -> Depth:
    assert frame.baseline_m is not None
    disparity_px = np.where(matched_px > 0, np.maximum(error.correct(matched_px, frame.camera), 1.0), 0)
    return Depth(convert_disparity(disparity_px.astype(np.float32), frame.camera.fx, frame.baseline_m))


def psmnet(frame: Frame, peer: Path, peer_weights: Path) -> Depth:
    """PSMNet as its authors run it: float32, ImageNet colours, zeros at the top and the right."""
    import torch

    net = _load_psmnet(peer, peer_weights)
    views = []
    for image in (frame.image(), frame.other()):
        colour = image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2)
        scaled = ((colour / 255.0 - MEAN) / SPREAD).astype(np.float32)
        height, width = scaled.shape[:2]
        padded = np.pad(scaled, ((-height % 32, 0), (0, -width % 32), (0, 0)))
        views.append(torch.from_numpy(padded.transpose(2, 0, 1).copy())[None])
    with torch.inference_mode():
        disparity_px = net(*views)[0].numpy()
    return _depth(frame, disparity_px[-height:, :width].astype(np.float32))


@cache
def _load_psmnet(peer: Path, peer_weights: Path) -> Any:
    import torch

    spec = importlib.util.spec_from_file_location("peer_psmnet", peer)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    net = module.PSMNet(192).eval()
    state = torch.load(peer_weights, map_location="cpu", weights_only=True)["state_dict"]
    net.load_state_dict({key.removeprefix("module."): value for key, value in state.items()})
    return net
