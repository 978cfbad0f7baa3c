"""The pictures of a drive's frames: image and true depth, and of each prior depth, error and confidence."""

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from eval.result import Result
from priors.cache import Prior
from priors.draw import panel
from priors.draw.panel import Tile
from priors.errors import DataError
from priors.report.legend import confidence_legend, depth_legend, error_legend
from priors.report.sample import Sample
from priors.report.wipe import Kind, Layer, Side, View, Wipe, coloured, photograph, shown_size
from priors.selection import select
from priors.types import Depth, Drive, Frame

DRIVE = "drive"
"""What the drive's own pictures are called."""
Read = TypeVar("Read")


def frames_wipe(
    drive: Drive, priors: Mapping[str, Prior], results: Sequence[Result], sample: Sample, frames: str | None = None
) -> Wipe | None:
    """Picture some frames that are spread evenly over those with maps; None where no picture can be read.

    Args:
        drive: the drive of all the priors.
        priors: by their names.
        results: their scores, in any order and as many as there are: a frame's figures stand below its error.
        sample: how many frames, how large.
        frames: only of this range of frames, a:b.
    """
    cached = {id_ for prior in priors.values() for id_ in prior.ids()}
    indices = [index for index in select(drive.ids, frames) if drive.ids[index] in cached]
    size = shown_size(drive[0].camera.size, sample.picture_width)
    figures = {(result.name, row.frame): row.metrics() for result in results for row in result.rows}
    views = [_view(drive[index], priors, figures, size) for index in sample.pick(indices)]
    views = [view for view in views if view.layers]
    if not views:
        return None
    remark = "" if len(views) == len(indices) else f"{len(views)} of {len(indices)} frames, spread evenly."
    left, right = _first_sides(views)
    return Wipe(views, size, kinds(), left, right, "source", LABELS, remark)


LABELS: Mapping[Side, str] = {(DRIVE, "depth"): "true depth"}


def kinds() -> dict[str, Kind]:
    """Return the kinds of pictures that a drive and its priors have."""
    return {
        "image": Kind("image"),
        "depth": Kind("depth", depth_legend()),
        "error": Kind("error", error_legend()),
        "confidence": Kind("confidence", confidence_legend()),
    }


def _first_sides(views: Sequence[View]) -> tuple[Side, Side]:
    """Choose what a reader sees first: the image beside the last prior's depth."""
    sides = [(layer.source, layer.kind) for layer in views[0].layers]
    maps = [side for side in sides if side[0] != DRIVE and side[1] == "depth"]
    return sides[0], maps[-1] if maps else sides[-1]


def _view(
    frame: Frame,
    priors: Mapping[str, Prior],
    figures: Mapping[tuple[str, str], Mapping[str, float]],
    size: tuple[int, int],
) -> View:
    """Draw one frame; what cannot be read is left out: the scores name it."""
    layers: list[Layer] = []
    image = tried(frame.image)
    if image is not None:
        layers.append(photograph(DRIVE, "image", image, size))
    truth = tried(frame.truth) if frame.has("truth") else None
    if truth is not None:
        layers.append(_layer(DRIVE, "depth", panel.depth_tile(truth, ""), size, _share(truth)))
    for name, prior in priors.items():
        depth = tried(lambda prior=prior: prior.read(frame.id)) if prior.has(frame.id) else None  # type: ignore[misc]
        if depth is None or depth.depth_m.shape != frame.camera.size:
            continue
        layers.append(_layer(name, "depth", panel.depth_tile(depth, ""), size, _share(depth)))
        if truth is not None and truth.depth_m.shape == depth.depth_m.shape:
            note = frame_note(figures.get((name, frame.id), {}))
            layers.append(_layer(name, "error", panel.error_tile(depth, truth), size, note))
        if depth.confidence is not None:
            layers.append(_layer(name, "confidence", panel.confidence_tile(depth), size, ""))
    return View(frame.id, layers)


def tried(read: Callable[[], Read]) -> Read | None:
    """Read what a page can do without; None where it cannot be read."""
    try:
        return read()
    except DataError:
        return None


def frame_note(figures: Mapping[str, float]) -> str:
    """Say a frame's figures; nothing where it was not scored."""
    return f"AbsRel {figures['abs_rel']:.4f}, RMSE {figures['rmse']:.2f} m" if figures else ""


def _layer(source: str, kind: str, tile: Tile, size: tuple[int, int], note: str) -> Layer:
    return coloured(source, kind, tile.picture, size, note)


def _share(depth: Depth) -> str:
    return f"{100 * depth.density:.1f} % of the pixels"
