"""`priors eval`: score cached maps against the drive's truth."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import tyro
from rich.markup import escape

from cli.arguments import drive_key, parse, reopen_drive
from cli.console import DATA_ERROR, err, out, progress
from eval import table
from eval.curves import Curves, Metric, ScoredPixels, best, curves, join
from eval.protocol import PRESETS, Protocol, ScoreError, preset
from eval.result import Comparison, Result, score
from priors import cache, codecs
from priors.build import select
from priors.cache import Prior
from priors.draw.plot import Line, plot
from priors.errors import DataError
from priors.naming import labels
from priors.types import Drive, Image

EXAMPLES = """Score cached maps against the drive's truth: one table a drive, one row a prior.
metrics.json is written beside the maps.

examples:
  priors eval cache/
  priors eval cache/ --protocol garg --frames 5:17 --save table.md
  priors eval cache/DRIVE/stereo-KEY --truth KITTI/depth --ranges --curves curves.png
  priors eval cache/ --against cache/DRIVE/lidar-KEY         another prior as truth
  priors eval a/metrics.json b/metrics.json --save table.tex  a table of results made before
"""


STUDY_SHARE = 0.9228
"""The density of the study's confidence-filtered stereo maps."""


@dataclass(frozen=True)
class ScoreArguments:
    """Arguments of `priors eval`."""

    caches: Annotated[tuple[Path, ...], tyro.conf.Positional] = (Path("cache"),)
    """Caches, drives' or priors' folders, or metrics.json files of earlier runs."""
    protocol: Literal[*PRESETS] = "paper"  # type: ignore[valid-type]
    """Which pixels count and how; docs/metrics.md has the definitions."""
    align: Literal["none", "median", "lsq"] | None = None
    """Fit each map to the truth first, instead of what the protocol says."""
    pooling: Literal["image", "pixel"] | None = None
    """Mean of the frames' figures or one figure over all pixels, instead of what the protocol says."""
    frames: str | None = None
    """Score only this range of frames, a:b."""
    truth: Path | None = None
    """Folder with KITTI depth maps, where the build was not told."""
    against: Path | None = None
    """Score against this prior instead of the drive's truth."""
    metrics: tuple[str, ...] | None = None
    """Columns of the table, e.g. abs_rel rmse d1; default: the protocol's usual ones."""
    ranges: bool = False
    """Also print AbsRel and RMSE by true distance."""
    curves: Path | None = None
    """Also draw the sparsification curves of priors with a confidence into this picture."""
    save: tuple[Path, ...] = ()
    """Also write the table: .md, .tex, .csv or .txt, as many as wanted."""


def run(arguments: list[str]) -> int:
    """Score; returns the exit code."""
    args = parse(ScoreArguments, "priors eval", EXAMPLES, arguments)
    files = [path for path in args.caches if path.suffix == ".json"]
    priors = [prior for path in args.caches if path not in files for prior in _with_maps(path)]
    drives = [list(together) for _, together in groupby(sorted(priors, key=drive_key), key=drive_key)]
    several = len(drives) + bool(files) > 1
    if files:
        _report([Result.load(path) for path in files], args, several)
    failed = [together for together in drives if not _try_drive(together, args, several)]
    return DATA_ERROR if failed else 0


def _try_drive(priors: list[Prior], args: ScoreArguments, several: bool) -> bool:
    """Score and print one drive; where it cannot be scored and there are others, say why and go on."""
    try:
        _report(_score_drive(priors, args, several), args, several)
    except (DataError, ScoreError) as error:
        if not several:
            raise
        err.print(f"[bold red]{priors[0].folder.parent}:[/] {escape(str(error))}")
        return False
    return True


def _with_maps(path: Path) -> list[Prior]:
    """Return the priors at path that have maps; those that have none yet are named and left out."""
    priors = cache.find(path)
    for prior in priors:
        if not prior.ids():
            out.print(f"{prior.folder}: no maps yet: left out")
    return [prior for prior in priors if prior.ids()]


def _protocol(args: ScoreArguments) -> Protocol:
    protocol = preset(args.protocol)
    changes = {
        "align": args.align,
        "pooling": args.pooling,
        "truth": None if args.against is None else args.against.name,
    }
    return replace(protocol, **{name: value for name, value in changes.items() if value is not None})  # type: ignore[arg-type]


def _score_drive(priors: list[Prior], args: ScoreArguments, several: bool) -> list[Result]:
    """Score the priors of one drive."""
    drive = reopen_drive(priors[0], args.truth)
    reference = None if args.against is None else cache.only(args.against)
    protocol = _protocol(args)
    results, drawn = [], []
    for prior, name in zip(priors, labels(priors), strict=True):
        ids = _scored_ids(prior, drive, reference, args.frames)
        fx_baseline = _fx_baseline(drive)
        info = {"prior": name, "drive": drive.name, "folder": prior.name}
        parts: list[ScoredPixels] = []
        wants_curves = args.curves is not None and (prior.folder / "confidence").is_dir()
        with progress(name, len(ids)) as step:
            frames = _pairs(prior, drive, reference, ids, step)
            result = score(frames, protocol, fx_baseline, info, parts.append if wants_curves else None)
        result.save(prior.folder / "metrics.json")
        results.append(result)
        if wants_curves:
            samples = join(parts)
            made = _curves(samples, fx_baseline)
            drawn.append(sparsification(name, made))
            out.print(_best_share(name, samples, fx_baseline))
            out.print(_areas(name, made))
    if drawn and args.curves is not None:
        path = args.curves.with_name(f"{args.curves.stem}-{drive.name}{args.curves.suffix}") if several else args.curves
        codecs.write_image(path, np.concatenate(drawn))
        out.print(f"wrote {path}")
    return results


def _scored_ids(prior: Prior, drive: Drive, reference: Prior | None, frames: str | None) -> list[str]:
    """List the cached frames that have a truth; DataError where none has."""
    wanted = {drive.ids[index] for index in select(drive.ids, frames)}
    cached = [id_ for id_ in prior.ids() if id_ in wanted]
    if not cached:
        asked = "" if frames is None else f" in --frames {frames}"
        raise DataError(f"{prior.folder}: no maps of {drive.name}{asked}: build them first")
    if reference is not None:
        return [id_ for id_ in cached if reference.has(id_)]
    index = {id_: i for i, id_ in enumerate(drive.ids)}
    with_truth = [id_ for id_ in cached if drive[index[id_]].has("truth")]
    if not with_truth:
        drive[index[cached[0]]].truth()  # raises with the drive's own reason
    return with_truth


def _pairs(
    prior: Prior, drive: Drive, reference: Prior | None, ids: Sequence[str], step: object
) -> Iterator[Comparison]:
    """Read map and truth of each frame as it is asked for."""
    index = {id_: i for i, id_ in enumerate(drive.ids)}
    for id_ in ids:
        made = prior.read(id_)
        truth = drive[index[id_]].truth() if reference is None else reference.read(id_)
        yield Comparison(id_, made.depth_m, made.confidence, truth.depth_m)
        if callable(step):
            step()


def _fx_baseline(drive: Drive) -> float | None:
    frame = drive[0]
    return None if frame.baseline_m is None else frame.camera.fx * frame.baseline_m


def _curves(samples: ScoredPixels, fx_baseline: float | None) -> list[Curves]:
    metrics: tuple[Metric, ...] = ("abs_rel", "rmse") if fx_baseline is None else ("abs_rel", "rmse", "d1")
    return [curves(samples, metric, fx_baseline) for metric in metrics]


def sparsification(name: str, made: Sequence[Curves]) -> Image:
    """Draw how a prior's errors fall as the least confident pixels are dropped, one plot a metric."""
    plots = []
    for curve in made:
        lines = [
            Line("by confidence", curve.kept, curve.by_confidence),
            Line("farthest first", curve.kept, curve.farthest_first),
            Line("oracle", curve.kept, curve.oracle, dashed=True),
        ]
        column = table.COLUMNS[curve.metric]
        plots.append(plot(lines, "share of the pixels kept", f"{column.label} {column.unit}".strip(), name))
    return np.concatenate(plots, axis=1)


def _areas(name: str, made: Sequence[Curves]) -> str:
    """Say how far each curve lies from the oracle's, beside the trivial confidence."""
    texts = [
        f"{table.COLUMNS[curve.metric].label} {curve.ause:.4g} (farthest first {curve.ause_farthest_first:.4g})"
        for curve in made
    ]
    return f"{name}: AUSE {', '.join(texts)}"


def _best_share(name: str, samples: ScoredPixels, fx_baseline: float | None) -> str:
    """Score the study's share of the pixels: the most confident ones, and the nearest, which need no confidence."""
    nearest = replace(samples, confidence=-samples.prediction_m)
    texts = []
    for chosen in (samples, nearest):
        figures = best(chosen, STUDY_SHARE, fx_baseline=fx_baseline)
        text = f"AbsRel {figures['abs_rel']:.4f}, SqRel {figures['sq_rel']:.4f} m, RMSE {figures['rmse']:.3f} m"
        texts.append(text + (f", D1 {figures['d1']:.3f} %" if "d1" in figures else ""))
    return f"{name}: the {STUDY_SHARE:.2%} most confident pixels {texts[0]}; the nearest {texts[1]}"


def _print_ranges(results: Sequence[Result]) -> None:
    """Print AbsRel and RMSE of each range of true distance."""
    for result in results:
        parts = [
            f"{low:g}-{high:g} m {figures['abs_rel']:.4f} {figures['rmse']:.3f} m"
            for (low, high), figures in result.by_range()
        ]
        out.print(f"{result.name}: AbsRel, RMSE by range: {'; '.join(parts)}")


def _report(results: Sequence[Result], args: ScoreArguments, several: bool) -> None:
    """Print one drive's table and write what was asked for."""
    drive = str(results[0].info.get("drive", ""))
    out.print(f"[bold]{drive}[/]")
    table.show(results, args.metrics, out)
    if args.ranges:
        _print_ranges(results)
    for path in args.save:
        path = path.with_name(f"{path.stem}-{drive}{path.suffix}") if several and drive else path
        table.save(results, path)
        out.print(f"wrote {path}")
