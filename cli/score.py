"""`priors eval`: score cached maps against the drive's truth."""

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.markup import escape

from cli.arguments import drive_key, parse, reopen_drive
from cli.console import DATA_ERROR, err, out, progress
from cli.show import compare
from eval import table
from eval.curves import Curves, Metric, ScoredPixels, best, curves, join
from eval.protocol import PRESETS, Protocol, ScoreError, preset
from eval.result import Comparison, Result, score
from priors import cache
from priors.build import select
from priors.cache import Prior
from priors.draw import figure, lines
from priors.errors import DataError, UsageError
from priors.naming import labels
from priors.report.page import SUFFIX, Picture
from priors.report.scores import scores_page, sparsification
from priors.types import Drive

EXAMPLES = """Score cached maps against the drive's truth: one table a drive, one row a prior.
metrics.json is written beside the maps.

examples:
  priors eval cache/
  priors eval cache/ --protocol garg --frames 5:17 --save table.md
  priors eval cache/ --save report.html                      a page with table, plots and pictures
  priors eval cache/DRIVE/stereo-KEY --truth KITTI/depth --ranges --curves curves.svg
  priors eval cache/ --against cache/DRIVE/lidar-KEY         another prior as truth
  priors eval a/metrics.json b/metrics.json --save table.tex  a table of results made before
"""


STUDY_SHARE = 0.9228
"""The density of the study's confidence-filtered stereo maps."""
PICTURED = 4
"""Frames whose maps are on a report page."""
TILE_PX = 400
"""Width of each map there."""


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
    """Also plot the sparsification curves of priors with a confidence: .png, .svg or .pdf."""
    save: tuple[Path, ...] = ()
    """Also write the table: .md, .tex, .csv, .txt, or .html, a report page; as many as wanted."""

    def __post_init__(self) -> None:
        for path in self.save:
            if path.suffix not in (*table.WRITERS, SUFFIX):
                raise UsageError(f"--save {path}: expected a name that ends in {', '.join((*table.WRITERS, SUFFIX))}")
        if self.curves is not None:
            figure.check_name(self.curves)

    @property
    def pages(self) -> bool:
        """Whether a report page is wanted."""
        return any(path.suffix == SUFFIX for path in self.save)


@dataclass(frozen=True)
class Scores:
    """What was found out about the priors of one drive."""

    results: list[Result]
    curves: dict[str, list[Curves]] = field(default_factory=dict)
    """By a prior's name, of those with a confidence, where curves were asked for."""
    pictures: list[Picture] = field(default_factory=list)
    """Where a page was asked for."""


def run(arguments: list[str]) -> int:
    """Score; returns the exit code."""
    args = parse(ScoreArguments, "priors eval", EXAMPLES, arguments)
    command = shlex.join(["priors", "eval", *arguments])
    files = [path for path in args.caches if path.suffix == ".json"]
    priors = [prior for path in args.caches if path not in files for prior in _with_maps(path)]
    drives = [list(together) for _, together in groupby(sorted(priors, key=drive_key), key=drive_key)]
    several = len(drives) + bool(files) > 1
    if files:
        _report(Scores([Result.load(path) for path in files]), args, several, command)
    failed = [together for together in drives if not _try_drive(together, args, several, command)]
    return DATA_ERROR if failed else 0


def _try_drive(priors: list[Prior], args: ScoreArguments, several: bool, command: str) -> bool:
    """Score and print one drive; where it cannot be scored and there are others, say why and go on."""
    try:
        _report(_score_drive(priors, args), args, several, command)
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


def _score_drive(priors: list[Prior], args: ScoreArguments) -> Scores:
    """Score the priors of one drive."""
    drive = reopen_drive(priors[0], args.truth)
    reference = None if args.against is None else cache.only(args.against)
    protocol = _protocol(args)
    names = labels(priors)
    scores = Scores([], {}, _pictures(drive, priors, names, args.frames) if args.pages else [])
    for prior, name in zip(priors, names, strict=True):
        ids = _scored_ids(prior, drive, reference, args.frames)
        fx_baseline = _fx_baseline(drive)
        info = {"prior": name, "drive": drive.name, "folder": prior.name}
        parts: list[ScoredPixels] = []
        wants_curves = (args.curves is not None or args.pages) and (prior.folder / "confidence").is_dir()
        with progress(name, len(ids)) as step:
            frames = _pairs(prior, drive, reference, ids, step)
            result = score(frames, protocol, fx_baseline, info, parts.append if wants_curves else None)
        result.save(prior.folder / "metrics.json")
        scores.results.append(result)
        if wants_curves:
            samples = join(parts)
            scores.curves[name] = _curves(samples, fx_baseline)
            out.print(_best_share(name, samples, fx_baseline))
            out.print(_areas(name, scores.curves[name]))
    return scores


def _pictures(drive: Drive, priors: Sequence[Prior], names: Sequence[str], frames: str | None) -> list[Picture]:
    """Draw the maps of some frames that are spread evenly over those with maps."""
    cached = {id_ for prior in priors for id_ in prior.ids()}
    chosen = [index for index in select(drive.ids, frames) if drive.ids[index] in cached]
    step = max(1, len(chosen) // PICTURED)
    pictures = []
    for index in chosen[step // 2 :: step][:PICTURED]:
        frame = drive[index]
        rows = [(name, prior.read(frame.id)) for name, prior in zip(names, priors, strict=True) if prior.has(frame.id)]
        pictures.append(Picture(f"frame {frame.id}", compare(frame, rows, TILE_PX)))
    return pictures


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


def _report(scores: Scores, args: ScoreArguments, several: bool, command: str) -> None:
    """Print one drive's table and write what was asked for."""
    results = scores.results
    drive = str(results[0].info.get("drive", ""))

    def own(path: Path) -> Path:
        return path.with_name(f"{path.stem}-{drive}{path.suffix}") if several and drive else path

    out.print(f"[bold]{drive}[/]")
    table.show(results, args.metrics, out)
    if args.ranges:
        _print_ranges(results)
    if args.curves is not None and scores.curves:
        plots = [plot for name, made in scores.curves.items() for plot in sparsification(name, made)]
        lines.write(own(args.curves), plots, max(map(len, scores.curves.values())))
        out.print(f"wrote {own(args.curves)}")
    for path in args.save:
        if path.suffix == SUFFIX:
            scores_page(results, args.metrics, scores.curves, scores.pictures, command).write(own(path))
        else:
            table.save(results, own(path))
        out.print(f"wrote {own(path)}")
