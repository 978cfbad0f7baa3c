"""Flags that several commands share."""

from collections.abc import Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import tyro

from cli import mistakes
from cli.console import err
from cli.renamed import translate
from priors import cache, drives, sequences
from priors.cache import Prior
from priors.drives import DriveOptions
from priors.errors import DataError, UsageError, expect_between
from priors.machine import threads
from priors.places import the_place
from priors.selection import select
from priors.types import Drive

if TYPE_CHECKING:  # the choices are the files of a folder: known when it runs
    DatasetName = str
    SequenceName = str
else:
    DatasetName = Literal["auto", *drives.names()]
    SequenceName = Literal[tuple(sequences.SEQUENCES)]
Device = Literal["auto", "cpu", "cuda"]
Parsed = TypeVar("Parsed")


@dataclass(frozen=True)
class DriveArguments:
    """Where a drive is and which part of it to read."""

    data: Annotated[Path | None, tyro.conf.Positional, tyro.conf.arg(metavar="[DATA]")] = None
    """The drive's folder, as downloaded, or its parent with --drive; default: the drive in the current folder, or the
    only one at most three folders down."""
    dataset: DatasetName = "auto"
    """Data set; auto recognises it from the folder."""
    part: tyro.conf.OmitArgPrefixes[DriveOptions] = DriveOptions()

    @property
    def names_drive(self) -> bool:
        """Whether the user says which drive it is."""
        return self.data is not None

    def open(self, typed: Sequence[str] = ()) -> Drive:
        """Open the drive; `typed`, program, command and flags, is repeated where there are several to choose from."""
        if self.data is not None:
            return drives.open_drive(self.data, self.dataset, self.part)
        place = the_place(Path(), self.part.drive, typed)
        err.print(f"drive: {place.path}")
        return drives.open_drive(place.path, place.dataset, replace(self.part, drive=None))


@dataclass(frozen=True)
class SequenceArguments(DriveArguments):
    """Where a drive is, or which published sequence of a drive is meant."""

    sequence: SequenceName | None = field(default=None, kw_only=True)
    """Drive, camera and frames of a published study: study-1 to study-5 are KITTI's, study-6 to study-8 Argoverse's.
    DATA is then the drive's folder, or one above it."""

    @property
    def names_drive(self) -> bool:
        """Whether the user says which drive it is."""
        return self.data is not None or self.sequence is not None

    def frame_range(self, frames: str | None) -> str | None:
        """Return the frames to take: the sequence's, else those that --frames asks for.

        Raises:
            UsageError: both say it, or a flag says what the sequence does.
        """
        if self.sequence is None:
            return frames
        said = {"--frames": frames, "--drive": self.part.drive, "--camera": self.part.camera}
        for flag, value in said.items():
            if value is not None:
                raise UsageError(f"{flag}: --sequence {self.sequence} says it: leave out one or the other")
        return sequences.SEQUENCES[self.sequence].range

    def open(self, typed: Sequence[str] = ()) -> Drive:
        """Open the drive, or the sequence's with its camera; one that lacks frames of it is refused."""
        if self.sequence is None:
            return super().open(typed)
        found = sequences.find(self.sequence, self.data or Path(), self.dataset)
        drive = drives.open_drive(found.place.path, found.place.dataset, replace(self.part, camera=found.camera))
        sequences.expect_whole(self.sequence, drive)
        frames = sequences.SEQUENCES[self.sequence].range
        err.print(f"{self.sequence}: {found.place.path}, {found.camera}, frames {frames or 'all'}")
        return drive

    def typed_drive(self) -> list[str]:
        """Return the words that name the drive and what is read of it, for a command that is printed."""
        words = [] if self.data is None else [str(self.data)]
        words += ["--sequence", self.sequence] if self.sequence is not None else []
        words += ["--dataset", self.dataset] if self.dataset != "auto" else []
        for each in fields(self.part):
            value = getattr(self.part, each.name)
            if value != each.default:
                words += [f"--{each.name.replace('_', '-')}", str(value)]
        return words


@dataclass(frozen=True)
class ThreadArguments:
    """How many cores to compute on."""

    threads: int | None = field(default=None, kw_only=True)
    """Threads to compute with, ours and the libraries'; default: OMP_NUM_THREADS, else every core it may use."""

    def __post_init__(self) -> None:
        expect_between(1, self.threads, threads.MOST_THREADS, "--threads")

    def limited(self) -> AbstractContextManager[None]:
        """Let what runs inside use so many."""
        return threads.limited(threads.usual() if self.threads is None else self.threads)


def find_priors(path: Path) -> list[Prior]:
    """Return the priors at path; those that cannot be read are named and left out, where there are others."""
    return cache.find(path, lambda error: err.complain(error, "left out"))


def by_drive(priors: Sequence[Prior]) -> list[list[Prior]]:
    """Put together the priors that were made for one drive, in the order of its name and place.

    It is one drive where calibration, poses and first image are the same by their digest, wherever it was when the
    maps were made. Another drive of the same name, or at the same place, is another one. Maps that another tool made
    may have no digest: their place tells.
    """
    groups: list[list[Prior]] = []
    for prior in sorted(priors, key=_place):
        group = next((group for group in groups if all(_is_same(prior, other) for other in group)), None)
        if group is None:
            groups.append([prior])
        else:
            group.append(prior)
    return groups


def drive_names(drives: Sequence[Sequence[Prior]]) -> list[str]:
    """Return the drives' names, each another one: those that share one have the start of their digest after it."""
    names = [str(priors[0].drive["name"]) for priors in drives]
    prints = [str(priors[0].manifest.get("fingerprint", ""))[:6] or str(number) for number, priors in enumerate(drives)]
    return [f"{name}-{own}" if names.count(name) > 1 else name for name, own in zip(names, prints, strict=True)]


def folders_to_name(drives: Sequence[Sequence[Prior]]) -> list[Path]:
    """Return for each drive the folder that stands for it in a command: its own, or a prior's where two share it."""
    homes = [priors[0].folder.parent for priors in drives]
    return [home if homes.count(home) == 1 else priors[0].folder for home, priors in zip(homes, drives, strict=True)]


def _place(prior: Prior) -> tuple[str, ...]:
    return tuple(str(prior.drive.get(field)) for field in ("name", "path", "camera"))


def _is_same(one: Prior, other: Prior) -> bool:
    prints = one.manifest.get("fingerprint"), other.manifest.get("fingerprint")
    if None in prints:
        return _place(one) == _place(other)
    cameras = one.drive.get("camera"), other.drive.get("camera")
    return prints[0] == prints[1] and cameras[0] == cameras[1]


def reopen_drive(priors: Sequence[Prior], truth: Path | None = None, data: Path | None = None) -> Drive:
    """Open the drive that priors were made for.

    Args:
        priors: of one drive; their manifests say where it was.
        truth: names its depth maps where the build was not told.
        data: where the drive is now; its files must be the same. The priors' manifests are brought up to date.
    """
    there = (prior.drive for prior in priors if Path(prior.drive.get("path", "")).is_dir())
    described = next(there, priors[0].drive)  # some may have been made before it moved
    if truth is not None:
        described = {**described, "truth": str(truth)}
    drive = drives.reopen(_with_near_poses(described, priors[0].folder.parent), data)
    for prior in priors:
        if drive.fingerprint() != prior.manifest.get("fingerprint", drive.fingerprint()):
            place = described["path"] if data is None else f"--data {data}"
            other = "build again, or name its own by --data" if data is None else "name the one they were made of"
            raise DataError(
                f"{place}: is not the drive of {prior.folder}: calibration, poses or first image differ: {other}"
            )
    for prior in priors if data is not None else []:
        moved = {**prior.manifest, "drive": {"name": drive.name, **drive.describe()}}
        with suppress(OSError):  # a cache that cannot be written is told of the new place each time
            cache.create(prior.folder, moved)
    return drive


def built_frames(priors: Sequence[Prior], drive: Drive, frames: str | None) -> list[int]:
    """Return the positions of a drive's frames of which a prior has a map, in a range a:b; DataError where none has."""
    built = {id_ for prior in priors for id_ in prior.ids()}
    found = [index for index in select(drive.ids, frames) if drive.ids[index] in built]
    if not found:
        raise DataError(f"{priors[0].folder.parent}: no maps of these frames: build them first")
    return found


def _with_near_poses(described: dict[str, Any], cache_of_drive: Path) -> dict[str, Any]:
    """Return a drive's description, with its refined poses beside the priors where the cache has moved."""
    place = Path(str(described.get("poses_from", "")))
    beside = cache_of_drive / place.name
    moved = "poses_from" in described and not place.is_dir() and beside.is_dir()
    return {**described, "poses_from": str(beside)} if moved else described


def parse(kind: type[Parsed], command: str, examples: str, arguments: list[str]) -> Parsed:
    """Parse a command's arguments into its dataclass, flags' earlier names too; --help shows its examples first."""
    return mistakes.parse(kind, command, examples, translate(kind, arguments))
