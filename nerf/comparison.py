"""The pictures of held-out views: image and true depth, and of each run colour, depth and their errors."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

from nerf.pictures import colour_error_bar, load_view, paint_colour_error
from nerf.run import Run, names_of
from nerf.truths import Truths
from priors.draw import panel
from priors.draw.colours import GOOD_TO_BAD
from priors.errors import DataError
from priors.report.frames import DRIVE, frame_note, tried
from priors.report.legend import Legend, depth_legend, error_legend, hexadecimal
from priors.report.sample import Sample
from priors.report.wipe import Kind, Layer, Side, View, Wipe, coloured, photograph, shown_size
from priors.types import Depth, Frame, Image

LABELS: Mapping[Side, str] = {(DRIVE, "colour"): "image", (DRIVE, "depth"): "true depth"}
Figures = Mapping[tuple[str, str], Mapping[str, float]]
"""By run and frame."""


def views_wipe(runs: Sequence[Run], figures: Figures, sample: Sample) -> Wipe | None:
    """Picture held-out views of runs of one drive, from what their reports have rendered; None where there are none."""
    drive, names = runs[0].drive, names_of(runs)
    held_out = {id_ for run in runs for id_ in (run.scene.ids[place] for place in run.scene.test)}
    ids = [id_ for id_ in drive.ids if id_ in held_out]
    size = shown_size(drive[0].camera.size, sample.picture_width)
    truths, named = Truths(drive, ids), dict(zip(names, runs, strict=True))
    views = [_view(drive[drive.ids.index(id_)], named, truths(id_), (figures, size)) for id_ in sample.pick(ids)]
    views = [view for view in views if len({layer.source for layer in view.layers}) > 1]
    if not views:
        return None
    alone = next((name for name, run in named.items() if run.config.prior is None), None)
    others = [name for name in names if name != alone]
    left = (alone or DRIVE, "colour")
    remark = "" if len(views) == len(ids) else f"{len(views)} of {len(ids)} held-out views, spread evenly."
    return Wipe(views, size, kinds(), left, (others[-1] if others else DRIVE, "colour"), "kind", LABELS, remark)


def kinds() -> dict[str, Kind]:
    """Return the kinds of pictures that a drive and its fields have."""
    edges = [text for _, text in colour_error_bar().ticks]
    words = [f"under {edges[0]}", *(f"{low} to {high}" for low, high in pairwise(edges))]
    words.append(f"over {edges[-1]}")
    readings = {hexadecimal(colour): word for colour, word in zip(GOOD_TO_BAD, words[: len(GOOD_TO_BAD)], strict=True)}
    return {
        "colour": Kind("colour"),
        "depth": Kind("depth", depth_legend()),
        "depth_error": Kind("depth error", error_legend()),
        "colour_error": Kind(
            "colour error", Legend("colour error, steps of 8 bits", colour_error_bar(), True, "", readings)
        ),
    }


def _view(frame: Frame, runs: Mapping[str, Run], truth: Depth | None, how: tuple[Figures, tuple[int, int]]) -> View:
    """Draw one held-out view; a run that did not hold it out, or has not rendered it, has no pictures of it."""
    figures, size = how
    image = tried(frame.image)
    layers: list[Layer] = [] if image is None else [photograph(DRIVE, "colour", image, size)]
    if truth is not None:
        layers.append(coloured(DRIVE, "depth", panel.depth_tile(truth, "").picture, size))
    for name, run in runs.items():
        layers += _layers(name, (run.folder, frame.id), (image, truth), figures.get((name, frame.id), {}), size)
    return View(frame.id, layers)


def _layers(
    name: str,
    where: tuple[Path, str],
    true: tuple[Image | None, Depth | None],
    figures: Mapping[str, float],
    size: tuple[int, int],
) -> list[Layer]:
    try:
        rgb, depth = load_view(where[0] / "renders", where[1])
    except DataError:
        return []  # it trains on this frame
    image, truth = true
    psnr = f"PSNR {figures['psnr']:.2f} dB" if figures else ""
    layers = [
        photograph(name, "colour", rgb, size, psnr),
        coloured(name, "depth", panel.depth_tile(depth, "").picture, size),
    ]
    if truth is not None:
        layers.append(coloured(name, "depth_error", panel.error_tile(depth, truth).picture, size, _note(figures)))
    if image is not None and image.shape == rgb.shape:
        layers.append(coloured(name, "colour_error", paint_colour_error(rgb, image), size, psnr))
    return layers


def _note(figures: Mapping[str, float]) -> str:
    return frame_note(figures) if figures and figures["abs_rel"] == figures["abs_rel"] else ""
