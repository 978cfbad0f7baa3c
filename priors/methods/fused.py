"""Depth of several sensors: LiDAR, stereo and one image, joined by how credible each is at a pixel."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import ClassVar, Literal, Self, get_args

from eval.calibration import Tolerance
from priors import build
from priors.build.stored import StoredMaps, merged
from priors.cache.learned import DriveSources
from priors.error_model import WITHIN
from priors.errors import DataError, UsageError
from priors.fusion import parts as joining
from priors.fusion.parts import Kind, Part, join_parts
from priors.machine import threads
from priors.methods.completion import Completion
from priors.methods.lidar import Lidar
from priors.methods.mono import Mono
from priors.methods.stereo import Stereo
from priors.types import Depth, Drive, Frame, Input, Method

Name = Literal["lidar", "completion", "stereo", "mono"]
USUAL: tuple[Name, ...] = ("lidar", "stereo", "mono")
KINDS: Mapping[str, Kind] = {"lidar": "measured", "completion": "matched", "stereo": "matched", "mono": "inferred"}


@dataclass(frozen=True)
class Fused(Method):
    """Join the maps of other methods: at each pixel the most credible one's surface, LiDAR first where it measured.

    The parts' maps are read from the cache under their own keys, and built where they lack. The confidence is the
    probability that the depth is right within 5 %.
    """

    parts: tuple[Name, ...] | None = None
    """Methods to join: lidar, completion, stereo, mono, or some of them. Default: those of lidar, stereo and mono that
    the drive has the data for."""
    lidar: Lidar = field(default_factory=Lidar)
    """The lidar method's settings."""
    completion: Completion = field(default_factory=Completion)
    """The completion method's settings, where it is a part."""
    stereo: Stereo = field(default_factory=Stereo)
    """The stereo method's settings."""
    mono: Mono = field(default_factory=Mono)
    """The mono method's settings."""

    VERSION: ClassVar[int] = joining.VERSION + sum(kind.VERSION - 1 for kind in (Lidar, Completion, Stereo, Mono))
    """Raised with those of its parts: a sum, so that each makes a new one."""
    JOINS: ClassVar[bool] = True

    def __post_init__(self) -> None:
        for name in self.parts or ():
            if name not in get_args(Name):
                raise UsageError(f"--fused.parts {name}: expected some of {', '.join(get_args(Name))}")
        if self.parts is not None and len(set(self.parts)) < max(1, len(self.parts)):
            given = " ".join(self.parts) or "nothing"
            raise UsageError(f"--fused.parts {given}: expected some of {', '.join(get_args(Name))}, each once")

    @property
    def reads(self) -> tuple[Input, ...]:
        """Return what a frame must have: of one part alone all that it needs, else the image."""
        chosen = self.chosen()
        if len(chosen) == 1:
            return next(iter(chosen.values())).reads
        if "completion" in chosen and "sparse" in self.completion.reads:
            return ("image", "sparse")  # the first of those maps is then part of the key
        return ("image",)

    @property
    def sure_within(self) -> Tolerance:
        """Return what the confidence is the probability of."""
        return WITHIN

    def chosen(self) -> dict[str, Method]:
        """Return the parts by their names, in one order whatever the order of the flags."""
        wanted = USUAL if self.parts is None else self.parts
        return {name: vars(self)[name] for name in get_args(Name) if name in wanted}

    def unread(self) -> Mapping[str, str]:
        """Return the settings of methods that are no part."""
        return {name: f"--fused.parts {name}" for name in get_args(Name) if name not in self.chosen()}

    @threads.limited(None)
    def resolve(self, frame: Frame) -> Self:
        """Return the config with the parts that the drive has the data for, each decided; settings of others are reset.

        Raises DataError where a part that was asked for lacks its data, and where there is none for any.
        """
        resolved: dict[str, Method] = {}
        reasons = {}
        for name, part in self.chosen().items():
            reason = lacks(part, frame)
            if reason is None:
                resolved[name] = part.resolve(frame)
                reason = lacks(resolved[name], frame)
            if reason is not None:
                resolved.pop(name, None)
                reasons[name] = reason
        if reasons and (self.parts is not None or not resolved):
            name, reason = next(iter(reasons.items()))
            raise DataError(f"fused: no {name}: {reason}")
        fresh = {name: type(vars(self)[name])() for name in get_args(Name)}
        return replace(self, parts=tuple(resolved), **{**fresh, **resolved})  # type: ignore[arg-type]

    def weights_digest(self) -> str | None:
        """Return a hash of the parts' weights, for the cache's key; None where none has any."""
        digests = {name: part.weights_digest() for name, part in self.chosen().items()}
        told = "/".join(f"{name}={digest}" for name, digest in digests.items() if digest is not None)
        return sha256(told.encode()).hexdigest() if told else None

    def notes(self) -> list[str]:
        """Say which parts there are, and what each has to say."""
        notes = [note for part in self.chosen().values() for note in part.notes()]
        return [f"fused: made of {_and(list(self.chosen()))}", *notes]

    def prepare(self, drive: Drive, folder: Path, on_note: Callable[[str], None] = lambda line: None) -> "Fuser":
        """Find the parts' maps in the cache: those beside the folder."""
        cache = folder.parent.parent
        jobs = {name: build.prepare(drive, part, None, cache) for name, part in self.chosen().items()}
        places = {frame_id: index for index, frame_id in enumerate(drive.ids)}
        return Fuser({name: StoredMaps(job, on_note) for name, job in jobs.items()}, places, on_note)

    @threads.limited(None)
    def __call__(self, frame: Frame) -> Depth:
        """Make the map (height, width), metres along the camera's z axis, without a cache: every part is computed."""
        config = self.resolve(frame)
        return join_parts({name: Part(part(frame), KINDS[name]) for name, part in config.chosen().items()})


@dataclass(frozen=True)
class Fuser:
    """Joins the parts' maps of a frame."""

    maps: Mapping[str, StoredMaps]
    """By the parts' names."""
    places: Mapping[str, int]
    """Frame id -> index into the drive."""
    on_note: Callable[[str], None]

    def __call__(self, frame: Frame) -> Depth:
        """Join the parts that the frame has a map of, and tell of the others; DataError where it has none."""
        parts, reasons = {}, {}
        for name, maps in self.maps.items():
            try:
                parts[name] = Part(maps.read(self.places[frame.id]), KINDS[name])
            except DataError as error:
                reasons[name] = str(error).removeprefix(f"frame {frame.id}: ")
        if not parts:
            raise DataError(f"frame {frame.id}: no part has a map: {next(iter(reasons.values()))}")
        for name, reason in reasons.items():
            self.on_note(f"frame {frame.id}: fused without {name}: {reason}")
        return join_parts(parts)

    def read_for(self, frame_id: str) -> DriveSources:
        """Return the files, by frame, that the parts' maps of a frame were made of."""
        return merged(*(maps.read_for(frame_id) for maps in self.maps.values()))


def lacks(part: Method, frame: Frame) -> str | None:
    """Say what a frame lacks for a part; None where it has all."""
    missing = [what for what in part.reads if not frame.has(what)]
    return None if not missing else frame.missing.get(missing[0], f"this drive has no {missing[0]}")


def _and(names: list[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
