"""Where a fit's depth comes from: a prior's folder in a cache, or the drive's own truth.

The truth is the study's GT rows: what a fit gains from depth without an error. A held-out frame's truth is what its
view is scored against, so it is never read for a fit.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, TypeAlias

from priors import cache
from priors.cache import Prior
from priors.drives import poses_of
from priors.errors import DataError
from priors.types import Depth, Drive, Frame

GUESSING = ("completion",)
"""Methods that fill a map with guesses where they measured nothing. Of completion's values with a confidence below
0.2, on drive 0009 and a street, 56 to 69 % are more than a tenth too near and 12 to 15 % too far; of stereo's 19 to
25 and 22 to 28 %."""


@dataclass(frozen=True)
class Truth:
    """The drive's own true depth as a prior."""

    name: ClassVar[str] = "truth"


TRUTH = Truth()
Guide: TypeAlias = Prior | Truth
"""What a fit may lean on."""


def place_of(guide: Guide) -> str:
    """Return what records a guide: a prior's folder, or 'truth'."""
    return guide.name if isinstance(guide, Truth) else str(guide.folder.resolve())


def open_guide(place: str | Path) -> Guide:
    """Open what `place_of` returned; DataError where a folder does not hold one prior."""
    return TRUTH if str(place) == TRUTH.name else cache.only(Path(place))


@dataclass(frozen=True)
class CachedMaps:
    """The maps of a cache's prior, as a scene copies them."""

    prior: Prior
    drive: Drive

    @property
    def name(self) -> str:
        """What the copies are called."""
        return self.prior.name

    @property
    def told(self) -> str:
        """What an error calls it."""
        return str(self.prior.folder)

    @property
    def has_confidence(self) -> bool:
        """Whether its values have one."""
        return self.prior.confidence_path("").parent.is_dir()

    @property
    def guesses(self) -> bool:
        """Whether its values of low confidence are guesses, most of them too near."""
        return self.prior.method in GUESSING

    def stamps(self, ids: Sequence[str], held_out: Sequence[str]) -> dict[str, str]:
        """Return what tells apart the maps of the frames that have one, by frame id.

        Raises:
            DataError: no frame has a map, or the prior is of another drive.
        """
        made_for = self.prior.manifest.get("fingerprint")
        if made_for is not None and made_for != self.drive.fingerprint():
            raise DataError(f"{self.told}: {self._other()}")
        stamps = {}
        for id_ in ids:
            with suppress(FileNotFoundError):
                stamps[id_] = _stamp(id_, self.prior.depth_path(id_))
        if not stamps:
            raise DataError(f"{self.told}: none of the {len(ids)} frames has a map: build the prior for them")
        return stamps

    def read(self, frame: Frame) -> Depth:
        """Read a frame's map; DataError where it has not the images' size."""
        depth, size = self.prior.read(frame.id), frame.camera.size
        if depth.depth_m.shape != size:
            path, shape = self.prior.depth_path(frame.id), depth.depth_m.shape
            raise DataError(f"{path}: {shape}, the images are {size}: build it again")
        return depth

    def _other(self) -> str:
        """Say in what the prior's drive differs from this one, and what to do."""
        made_with, these = poses_of(self.prior.drive), poses_of(self.drive.describe())
        if made_with != these and self.prior.drive.get("path") == self.drive.describe().get("path"):
            return f"made with {made_with} poses, these are {these}: --poses {made_with}, or build it anew"
        return f"made for {self.prior.drive.get('path')}, not for this {self.drive.name}: build it anew"


@dataclass(frozen=True)
class TrueMaps:
    """The drive's true depth, as a scene copies it: of frames that are not held out."""

    drive: Drive
    name: ClassVar[str] = TRUTH.name
    has_confidence: ClassVar[bool] = False
    guesses: ClassVar[bool] = False

    @property
    def told(self) -> str:
        """What an error calls it."""
        return f"{self.drive.name}: its truth"

    def stamps(self, ids: Sequence[str], held_out: Sequence[str]) -> dict[str, str]:
        """Return what tells apart the true maps of the frames that have one and are not held out, by frame id.

        Raises:
            DataError: no such frame has a true map.
        """
        stamps, lacking, scored = {}, "", set(held_out)
        places = {id_: position for position, id_ in enumerate(self.drive.ids)}
        for id_ in ids:
            if id_ in scored:
                continue
            frame = self.drive[places[id_]]
            if frame.has("truth"):
                where = frame.files["truth"]() if "truth" in frame.files else None
                stamps[id_] = id_ if where is None else _stamp(id_, where)
            else:
                lacking = lacking or frame.missing.get("truth", "this drive has no true depth")
        if not stamps:
            raise DataError(f"{self.drive.name}: no true depth to learn from: {lacking or 'all frames are held out'}")
        return stamps

    def read(self, frame: Frame) -> Depth:
        """Read a frame's true depth."""
        return frame.truth()


Maps: TypeAlias = CachedMaps | TrueMaps


def maps_of(guide: Guide, drive: Drive) -> Maps:
    """Return a guide's maps of a drive's frames."""
    return TrueMaps(drive) if isinstance(guide, Truth) else CachedMaps(guide, drive)


def _stamp(id_: str, path: Path) -> str:
    """Tell a file's content as good as can be without reading it."""
    file = path.stat()
    return f"{id_}:{file.st_size}:{file.st_mtime_ns}"
