"""Results of checks, kept beside the prior's maps: the same maps and frames are not checked twice.

<folder of the prior's maps>/checked-<digest>.npy   how far each value is trusted: uint8 (frames, height, width)
                            /checked-<digest>.json  finding and factors; written last, so that it marks both as done
"""

import hashlib
import json
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from eval.files import write_bytes
from nerf.evidence.finding import Finding
from nerf.scene import Scene
from nerf.stack import Stack, StackWriter

VERSION = 3
"""Raised when the same scene is judged otherwise: what was kept of it is not read then."""
Trust: TypeAlias = Stack | npt.NDArray[np.uint8]
"""(frames, height, width) how far each value is trusted, x 255."""


@dataclass(frozen=True)
class Kept:
    """A finding, and what corrects the maps."""

    finding: Finding
    trust: Trust | None = None
    """None: all are trusted."""
    factors: list[float] = field(default_factory=list)
    """What each frame's depths are multiplied by."""


def place_of(scene: Scene, *others: object) -> Path | None:
    """Return where the check of a scene is kept, without an ending; None: its maps are no files.

    `others`: what else decides the finding.
    """
    if not isinstance(scene.depth_m, Stack):
        return None
    decided = repr((VERSION, scene.train, *others)).encode() + scene.T_world_cam.tobytes()
    return scene.depth_m.path.parent / f"checked-{hashlib.sha256(decided).hexdigest()[:10]}"


def read(place: Path | None) -> Kept | None:
    """Read what was kept; None where nothing was."""
    if place is None or not place.with_suffix(".json").exists():
        return None
    record = json.loads(place.with_suffix(".json").read_text(encoding="utf-8"))
    factors = record.pop("factors")
    finding, trust = Finding.of(record), place.with_suffix(".npy")
    return Kept(finding, Stack(trust) if finding.dropped else None, factors)


def keep(place: Path | None, kept: Kept) -> None:
    """Keep a finding; its trust was written by `Rounds`, and goes where it is not used."""
    if place is not None:
        if kept.trust is None:
            place.with_suffix(".npy").unlink(missing_ok=True)
        write_bytes(place.with_suffix(".json"), json.dumps(asdict(kept.finding) | {"factors": kept.factors}).encode())


@dataclass(frozen=True)
class Rounds:
    """Writes the trust of all frames, round after round, a frame at a time; in memory where there are no files."""

    place: Path | None
    shape: tuple[int, ...]
    """(frames, height, width)."""
    folder: Path | None
    """Holds what is not the last round's."""

    @classmethod
    @contextmanager
    def at(cls, place: Path | None, shape: tuple[int, ...]) -> Iterator["Rounds"]:
        """Write into files of this process alone until the last round."""
        with ExitStack() as opened:
            folder = None
            if place is not None:
                folder = Path(opened.enter_context(tempfile.TemporaryDirectory(prefix=".votes-", dir=place.parent)))
            yield cls(place, shape, folder)

    def write(self, frames: Iterator[npt.NDArray[np.uint8]], *, last: bool) -> Trust:
        """Write a round's trust, (h, w) a frame."""
        if self.place is None or self.folder is None:
            return np.stack(list(frames))
        path = self.place.with_suffix(".npy")
        if not last:
            path = self.folder / f".{self.place.name}.npy"  # by this name a killed run's is dropped in time
        with StackWriter(path, self.shape, np.uint8) as files:
            for frame in frames:
                files.add(frame)
        return Stack(path)
