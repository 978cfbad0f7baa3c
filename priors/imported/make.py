"""Makes a prior of another program's depth maps."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib.metadata import version
from pathlib import Path

from priors import cache, codecs, keys
from priors.cache import Prior
from priors.check import Finding
from priors.check.imported import judge_imported
from priors.drives import CameraDrive
from priors.errors import DataError, UsageError
from priors.imported.encoding import Encoding
from priors.imported.match import match
from priors.records import record
from priors.selection import first_readable, pick_middles
from priors.sky import VERSION as SKY_VERSION
from priors.types import Depth, Drive, FloatMap, Frame

METHOD = "imported"
"""What such priors are called in folders and tables; no method of this name makes maps."""
COMPARED = 8
"""Frames whose maps are compared with what else measures depth."""


@dataclass(frozen=True)
class ImportReport:
    """What an import did."""

    prior: Prior
    written: list[str] = field(default_factory=list)
    """Ids of the frames whose maps were written."""
    failed: dict[str, str] = field(default_factory=dict)
    """Frame id -> one-line error."""


@dataclass(frozen=True)
class Import:
    """Maps that can be imported: they are joined to frames and have a place in the cache; nothing is written yet."""

    drive: Drive
    encoding: Encoding
    files: Mapping[str, Path]
    """Frame id -> map."""
    prior: Prior

    @cached_property
    def _places(self) -> dict[str, int]:
        return {id_: index for index, id_ in enumerate(self.drive.ids)}

    def read(self, id_: str) -> tuple[Frame, Depth]:
        """Read a frame's map as camera-z metres, of the image as the frame shows it.

        Raises:
            DataError: the map is damaged, of another size, or cannot be converted.
        """
        path, frame = self.files[id_], self.drive[self._places[id_]]
        numbers = shown(self.drive, codecs.read_numbers(path), id_)
        if numbers.shape != frame.camera.size:
            found, wanted = (f"{width}x{height}" for height, width in (numbers.shape, frame.camera.size))
            raise DataError(f"{path}: is {found}, the image {wanted}: resize it, without blending")
        return frame, Depth(self.encoding.depth_m(numbers, frame))

    def compare(self) -> list[Finding]:
        """Compare some of the maps with the LiDAR, truth and stereo; nothing is known where there is none of them."""
        samples = []
        for id_ in pick_middles(list(self.files), COMPARED):
            try:
                samples.append(self.read(id_))
            except DataError:
                continue  # told when it is imported
        return judge_imported([(frame, depth.depth_m) for frame, depth in samples], float(self.encoding.fraction))

    def run(self, on_frame: Callable[[str], None] = lambda frame_id: None) -> ImportReport:
        """Write the maps that are not there; a map that cannot be read is reported, and the others go on."""
        report = ImportReport(self.prior)
        cache.create(self.prior.folder, self.prior.manifest)
        for id_, path in self.files.items():
            if not self.prior.has(id_):
                try:
                    _, depth = self.read(id_)
                    self.prior.write(id_, depth, 0.0, {METHOD: {"file": path.name, "sha256": _digest(path)}})
                    report.written.append(id_)
                except DataError as error:
                    report.failed[id_] = str(error)
            on_frame(id_)
        return report


def prepare(drive: Drive, folder: Path, encoding: Encoding, into: Path) -> Import:
    """Join maps to a drive's frames, and find their place in the cache.

    Raises:
        UsageError: the unit of PNG files is not said.
        DataError: no map belongs to a frame.
    """
    files = match(drive.ids, folder)
    if encoding.unit is None and any(path.suffix.lower() == ".png" for path in files.values()):
        raise UsageError("--unit: a PNG does not tell what one is: --unit 1/256 is KITTI's, --unit mm nerfstudio's")
    encoding = encoding.plain()
    frame = first_readable(drive)
    manifest = {
        "format": cache.FORMAT,
        "code": version("roadprior"),
        "method": METHOD,
        "version": Encoding.VERSION,
        "config": record(encoding),
        "source": folder.resolve().name,
        "filters": {},
        "sky": SKY_VERSION,
        "weights": None,
        "maps": _digest_all(files),
        "camera": {"K": frame.camera.K.tolist(), "size": list(frame.camera.size), "baseline_m": frame.baseline_m},
        "encoding": "kitti",
        "drive": {"name": drive.name, **drive.describe()},
        "fingerprint": drive.fingerprint(),
    }
    key = keys.key(manifest, Encoding)
    return Import(drive, encoding, files, Prior(into / drive.name / f"{METHOD}-{key}", {**manifest, "key": key}))


def shown(drive: Drive, numbers: FloatMap, id_: str) -> FloatMap:
    """Return a map of an image as it is stored, as the frame shows the image."""
    inner = getattr(drive, "drive", drive)  # of a drive with refined poses
    return inner.shown_map(numbers, id_) if isinstance(inner, CameraDrive) else numbers


def _digest_all(files: Mapping[str, Path]) -> str:
    """Hash which frame has which map."""
    sha = hashlib.sha256()
    for id_, path in files.items():
        sha.update(f"{id_}\0{_digest(path)}\n".encode())
    return sha.hexdigest()


def _digest(path: Path) -> str:
    return hashlib.sha256(codecs.read_bytes(path)).hexdigest()
