"""Flags that several commands share."""

from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

import tyro

from cli import mistakes
from cli.renamed import translate
from priors import drives
from priors.cache import Prior
from priors.drives import DriveOptions
from priors.errors import UsageError
from priors.machine import threads
from priors.types import Drive

if TYPE_CHECKING:  # the choices are the files of a folder: known when it runs
    DatasetName = str
else:
    DatasetName = Literal["auto", *drives.names()]
Device = Literal["auto", "cpu", "cuda"]
Parsed = TypeVar("Parsed")


@dataclass(frozen=True)
class DriveArguments:
    """Where a drive is and which part of it to read."""

    data: Annotated[Path, tyro.conf.Positional]
    """The drive's folder, as downloaded, or its parent with --drive."""
    dataset: DatasetName = "auto"
    """Data set; auto recognises it from the folder."""
    part: tyro.conf.OmitArgPrefixes[DriveOptions] = DriveOptions()

    def open(self) -> Drive:
        """Open the drive."""
        return drives.open_drive(self.data, self.dataset, self.part)


@dataclass(frozen=True)
class ThreadArguments:
    """How many cores to compute on."""

    threads: int | None = field(default=None, kw_only=True)
    """Threads to compute with, ours and the libraries'; default: OMP_NUM_THREADS, else every core it may use."""

    def __post_init__(self) -> None:
        if self.threads is not None and self.threads < 1:
            raise UsageError(f"--threads {self.threads}: expected 1 or more")

    def limited(self) -> AbstractContextManager[None]:
        """Let what runs inside use so many."""
        return threads.limited(threads.usual() if self.threads is None else self.threads)


def drive_key(prior: Prior) -> tuple[str, ...]:
    """Return what tells apart the drives that priors were made for."""
    return tuple(str(prior.drive.get(field)) for field in ("name", "path", "camera"))


def reopen_drive(prior: Prior, truth: Path | None) -> Drive:
    """Open the drive that a prior was made for; `truth` names its depth maps where the build was not told."""
    return drives.reopen(prior.drive if truth is None else {**prior.drive, "truth": str(truth)})


def parse(kind: type[Parsed], command: str, examples: str, arguments: list[str]) -> Parsed:
    """Parse a command's arguments into its dataclass, flags' earlier names too; --help shows its examples first."""
    return mistakes.parse(kind, command, examples, translate(kind, arguments))
