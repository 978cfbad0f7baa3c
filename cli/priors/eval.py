"""`priors eval`: score cached maps against the drive's truth."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from cli.arguments import by_drive, drive_names, parse, reopen_drive
from cli.console import DATA_ERROR, busy, err, out, progress
from cli.engine import EngineArguments
from cli.mistakes import nearest
from cli.written import expect_file
from eval import table
from eval.curves import Curves
from eval.protocol import PRESETS, Protocol, preset
from eval.reliability import Reliability
from eval.result import Result
from priors import cache
from priors.cache import Prior
from priors.draw import figure, lines
from priors.errors import DataError, UsageError, expect
from priors.naming import labels
from priors.reliability import only_held_back, reliabilities
from priors.report.frames import frames_wipe
from priors.report.page import SUFFIX
from priors.report.sample import Sample
from priors.report.scores import DriveScores, reliability_plots, scores_page, sparsification
from priors.score import Score, Scorer, pair, score_pairs
from priors.selection import parse_range, select
from priors.types import Drive

EXAMPLES = """Score cached maps against the drive's truth: one table a drive, one row a prior.
metrics.json is written beside the maps.

examples:
  priors eval cache/
  priors eval cache/ --protocol garg --frames 5:17 --save table.md
  priors eval cache/ --save report.html                      a page with table, plots and pictures
  priors eval cache/DRIVE/stereo-KEY --truth KITTI/depth --ranges --curves curves.svg
  priors eval cache/ --reliability reliability.png           is what is 90 % sure right nine times of ten?
  priors eval cache/ --held-back                             on frames that no network of ours was trained on
  priors eval cache/ --temporal                              how steady the maps are from frame to frame
  priors eval cache/ --against cache/DRIVE/lidar-KEY         another prior as truth
  priors eval cache/ --engine ray --address auto             frames are scored on a Ray cluster
  priors eval a/metrics.json b/metrics.json --save table.tex  a table of results made before
"""


STUDY_SHARE = 0.9228
"""The density of the study's confidence-filtered stereo maps."""


@dataclass(frozen=True)
class ScoreArguments:
    """Arguments of `priors eval`."""

    caches: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[CACHE ...]")] = (Path("cache"),)
    """Caches, drives' or priors' folders, or metrics.json files of earlier runs."""
    protocol: Literal[*PRESETS] = "paper"  # type: ignore[valid-type]
    """Which pixels count and how; docs/metrics.md has the definitions."""
    align: Literal["none", "median", "lsq"] | None = None
    """Fit each map to the truth first, instead of what the protocol says."""
    pooling: Literal["image", "pixel"] | None = None
    """Mean of the frames' figures or one figure over all pixels, instead of what the protocol says."""
    frames: str | None = None
    """Score only this range of frames, a:b."""
    held_back: bool = False
    """Score only frames that no network of ours was trained on: docs/training.md names them."""
    truth: Path | None = None
    """Folder with KITTI depth maps, where the build was not told."""
    data: Path | None = None
    """Where the drive is now, if it has moved since the build."""
    against: Path | None = None
    """Score against this prior instead of the drive's truth."""
    metrics: tuple[str, ...] | None = None
    """Columns of the table, e.g. abs_rel rmse d1, or as tables print them; default: the protocol's usual ones."""
    long: bool = False
    """Name each prior with every setting that is not usual, not only with what differs between rows."""
    temporal: bool = False
    """Also measure the flicker: how much the depth of a still point differs from frame to frame, by the poses."""
    ranges: bool = False
    """Also print AbsRel and RMSE by true distance."""
    curves: Path | None = None
    """Also plot the sparsification curves of priors with a confidence: .png, .svg or .pdf."""
    reliability: Path | None = None
    """Also plot, for each stated probability, the share of values that is right: .png, .svg or .pdf."""
    save: tuple[Path, ...] = ()
    """Also write the table: .md, .tex, .csv, .txt, or .html, a report page; as many as wanted."""
    engine: tyro.conf.OmitArgPrefixes[EngineArguments] = field(default_factory=EngineArguments)

    def __post_init__(self) -> None:
        if self.engine.engine == "ray" and (self.page or self.curves is not None or self.reliability is not None):
            flag = "--save .html" if self.page else "--curves" if self.curves is not None else "--reliability"
            raise UsageError(f"{flag}: needs all pixels in one process: leave it out, or --engine ray")
        for path in (self.curves, self.reliability):
            if path is not None:
                figure.check_name(path)
        parse_range(self.frames)
        for name in self.metrics or ():
            _metric(name)

    def expect_writable(self) -> None:
        """Raise UsageError where a file that is asked for cannot be written."""
        for path in self.save:
            expect_file("--save", path, (*table.WRITERS, SUFFIX))
        for flag, picture in (("--curves", self.curves), ("--reliability", self.reliability)):
            if picture is not None:
                expect_file(flag, picture)

    @property
    def keys(self) -> list[str] | None:
        """The columns that were asked for, by their keys."""
        return None if self.metrics is None else list(map(_metric, self.metrics))

    @property
    def page(self) -> bool:
        """Whether a report page is wanted."""
        return any(path.suffix == SUFFIX for path in self.save)


@dataclass(frozen=True)
class Output:
    """Prints and writes what was asked for."""

    args: ScoreArguments
    command: str
    """As typed."""
    several: bool
    """Whether there are several drives: the names of their plots then have the drive's in them."""
    scorer: Scorer | None = None
    """What scores elsewhere; None: here."""

    def show(self, scored: DriveScores) -> None:
        """Print one drive's table and write its plot."""
        out.print(scored.drive, style="bold")
        table.show(scored.results, self.args.keys, out)
        if self.args.ranges:
            _print_ranges(scored.results)
        if self.args.curves is not None and scored.curves:
            plots = [plot for name, drawn in scored.curves.items() for plot in sparsification(name, drawn)]
            self._plot(self.args.curves, scored.drive, plots, max(map(len, scored.curves.values())))
        if self.args.reliability is not None and scored.reliability:
            plots = [plot for name, made in scored.reliability.items() for plot in reliability_plots(name, made)]
            self._plot(self.args.reliability, scored.drive, plots, min(len(plots), 4))

    def save(self, drives: Sequence[DriveScores]) -> None:
        """Write one file of each format that was asked for, with the tables of all drives."""
        for path in self.args.save:
            if path.suffix == SUFFIX:
                with busy("page"):
                    scores_page(drives, self.args.keys, self.command, Sample().room).write(path)
            else:
                table.save([(scored.drive, scored.results) for scored in drives], path, self.args.keys)
            out.print(f"wrote {path}")

    def _plot(self, asked: Path, drive: str, plots: Sequence[lines.Plot], columns: int) -> None:
        """Write plots of one drive."""
        path = self._place(asked, drive)
        with busy("plots"):
            lines.write(path, plots, columns)
        out.print(f"wrote {path}")

    def _place(self, path: Path, drive: str) -> Path:
        """Return where a file of a drive goes."""
        return path.with_name(f"{path.stem}-{drive}{path.suffix}") if self.several and drive else path


ARGUMENTS = {"priors eval": ScoreArguments}


def run(arguments: list[str]) -> int:
    """Score; returns the exit code."""
    args = parse(ScoreArguments, "priors eval", EXAMPLES, arguments)
    args.expect_writable()
    with args.engine.scorer() as scorer:
        return _score(args, scorer, arguments)


def _score(args: ScoreArguments, scorer: Scorer | None, arguments: list[str]) -> int:
    loaded = _load([path for path in args.caches if path.suffix == ".json"])
    refused: list[DataError] = []
    drives = by_drive([prior for path in args.caches if path.suffix != ".json" for prior in with_maps(path, refused)])
    output = Output(args, shlex.join(["priors", "eval", *arguments]), len(drives) + len(loaded) > 1, scorer)
    for results in loaded:
        output.show(results)
    scored = [_try_drive(together, name, output) for together, name in zip(drives, drive_names(drives), strict=True)]
    for error in refused:
        err.complain(error, "left out")
    shown = [*loaded, *(one for one in scored if one is not None)]
    if shown:
        output.save(shown)
    return DATA_ERROR if refused or any(one is None or one.left_out for one in scored) else 0


def _load(files: Sequence[Path]) -> list[DriveScores]:
    """Read results that were made before; those of one drive stand together."""
    drives: dict[str, DriveScores] = {}
    for path in files:
        result = Result.load(path)
        drives.setdefault(str(result.info.get("drive", "")), DriveScores([])).results.append(result)
    return list(drives.values())


def with_maps(path: Path, refused: list[DataError]) -> list[Prior]:
    """Return the priors at path that have maps; those that have none yet are named, those that cannot be read kept."""
    priors = cache.find(path, refused.append)
    for prior in priors:
        if not prior.ids():
            out.print(f"{prior.folder}: no maps yet: left out")
    return [prior for prior in priors if prior.ids()]


def _try_drive(priors: list[Prior], name: str, output: Output) -> DriveScores | None:
    """Score and print one drive; where it cannot be scored and there are others, say why and return None."""
    try:
        scored = _score_drive(priors, name, output.args, output.scorer)
        output.show(scored)
    except DataError as error:
        if not output.several:
            raise
        err.complain(error, priors[0].folder.parent)
        return None
    for what, why in scored.left_out.items():
        err.complain(why, f"left out: {what}")
    return scored


def _score_drive(priors: list[Prior], drive_name: str, args: ScoreArguments, scorer: Scorer | None) -> DriveScores:
    """Score the priors of one drive; one that cannot be scored is left out. DataError where none can."""
    with busy("opening the drive"):
        drive, names = reopen_drive(priors, args.truth, args.data), labels(priors, args.long)
    select(drive.ids, args.frames)  # frames that no prior can have are told once
    scored = DriveScores([], priors=dict(zip(names, priors, strict=True)), name=drive_name)
    for name in names:
        try:
            one = score_prior(scored, name, drive, args, scorer)
        except DataError as error:
            if len(names) == 1:
                raise
            scored.left_out[name] = str(error)
            continue
        if one.pixels is not None:
            with busy(f"best pixels of {name}"):
                best = _best_share(one)
            out.print(f"{name}: {best}")
            out.print(f"{name}: {_areas(scored.curves[name])}")
        if args.reliability is not None:
            for line in _calibration(scored.reliability.get(name, [])):
                out.print(f"{name}: {line}")
    if not scored.results:
        raise DataError(f"none of its {len(names)} priors can be scored, the first: {scored.left_out[names[0]]}")
    if args.page:
        with busy("pictures for the page"):
            wipe = frames_wipe(drive, scored.priors, scored.results, Sample(), args.frames)
        scored = replace(scored, wipe=wipe)
    return scored


def score_prior(
    scored: DriveScores, name: str, drive: Drive, args: ScoreArguments, scorer: Scorer | None = None
) -> Score:
    """Score one of the priors, and note its result, its curves, and what had to be left out."""
    prior = scored.priors[name]
    pairs = pair(prior, drive, args.frames, None if args.against is None else cache.only(args.against))
    pairs = replace(only_held_back(pairs) if args.held_back else pairs, scorer=scorer)
    if not pairs.ids:
        raise DataError(f"{prior.folder}: --held-back: none of its frames is held back from training")
    with progress(name, len(pairs)) as step:
        one = score_pairs(pairs, _protocol(args), name, args.page or args.curves is not None, step, args.temporal)
    scored.results.append(one.result)
    scored.left_out.update({f"{name}, frame {id_}": why for id_, why in pairs.left_out.items()})
    if one.unsaved is not None:
        scored.left_out[f"{name}, metrics.json"] = one.unsaved
    if one.pixels is not None:
        with busy(f"sparsification curves of {name}"):
            scored.curves[name] = one.curves()
    if args.page or args.reliability is not None:
        with busy(f"reliability of {name}"):
            made = reliabilities(pairs, one.result.protocol)
        if made:
            scored.reliability[name] = made
    return one


def _metric(name: str) -> str:
    """Return the key of a column that is named by its key or as tables print it: abs_rel, abs-rel, AbsRel."""
    printed = {column.label.casefold(): key for key, column in table.COLUMNS.items()}
    key = printed.get(name.casefold(), name.casefold().replace("-", "_"))
    wanted = f"some of {', '.join(table.COLUMNS)}{nearest(key, list(table.COLUMNS))}"
    expect(key in table.COLUMNS, "--metrics", name, wanted)
    return key


def _protocol(args: ScoreArguments) -> Protocol:
    """Return the protocol that was named, with the changes that were asked for."""
    protocol = preset(args.protocol)
    return replace(protocol, align=args.align or protocol.align, pooling=args.pooling or protocol.pooling)


def _areas(curves: Sequence[Curves]) -> str:
    """Say how far each curve lies from the oracle's, beside the trivial confidence."""
    texts = [
        f"{table.COLUMNS[curve.metric].label} {curve.ause:.4g} (farthest first {curve.ause_farthest_first:.4g})"
        for curve in curves
    ]
    return f"AUSE {', '.join(texts)}"


def _calibration(made: Sequence[Reliability]) -> list[str]:
    """Say what each probability states and what came true."""
    return [
        f"within {one.within} it says {one.says:.3f}, {one.is_right:.3f} is right; calibration error {one.error:.3f}"
        for one in made
    ] or ["states no probability"]


def _best_share(score: Score) -> str:
    """Tell the figures of the study's share of the pixels: the most confident ones, and the nearest."""
    confident, nearest = map(_figures, (score.most_confident(STUDY_SHARE), score.nearest(STUDY_SHARE)))
    return f"the {STUDY_SHARE:.2%} most confident pixels {confident}; the nearest {nearest}"


def _figures(figures: dict[str, float]) -> str:
    text = f"AbsRel {figures['abs_rel']:.4f}, SqRel {figures['sq_rel']:.4f} m, RMSE {figures['rmse']:.3f} m"
    return text + (f", D1 {figures['d1']:.3f} %" if "d1" in figures else "")


def _print_ranges(results: Sequence[Result]) -> None:
    """Print AbsRel and RMSE of each range of true distance."""
    for result in results:
        parts = [
            f"{low:g}-{high:g} m {figures['abs_rel']:.4f} {figures['rmse']:.3f} m"
            for (low, high), figures in result.by_range()
        ]
        out.print(f"{result.name}: AbsRel, RMSE by range: {'; '.join(parts)}")
