"""Keys: what they are made of stays what it is, and maps of the same decisions are found whatever their key was."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_build import SIZE, Line

from priors import build, cache, keys, methods
from priors.filters import Filters
from priors.records import Aliases, record
from priors.types import Depth, Frame, Input, Method

whatever_the_load = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
values = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text()
parts = st.dictionaries(st.text(), values | st.lists(values) | st.dictionaries(st.text(), values))


@whatever_the_load
@given(parts, st.randoms())
def test_the_key_ignores_order(entries: dict[str, object], random: object) -> None:
    shuffled = list(entries.items())
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    assert keys.key_of(entries) == keys.key_of(dict(shuffled))


@whatever_the_load
@given(parts, parts)
def test_other_parts_have_another_key(one: dict[str, object], two: dict[str, object]) -> None:
    same = json.dumps(one, sort_keys=True) == json.dumps(two, sort_keys=True)
    assert (keys.key_of(one) == keys.key_of(two)) == same


KNOWN = {
    "filters": Filters(sky="mask", clip=80.0, density=0.5, density_seed=3).record(),
    "sky": 3,
    "weights": "0f" * 32,
    "fingerprint": "f0" * 32,
    "maps": None,
    "camera": {
        "K": [[721.5, 0.0, 609.6], [0.0, 721.5, 172.9], [0.0, 0.0, 1.0]],
        "size": [375, 1242],
        "baseline_m": 0.54,
    },
    "encoding": "kitti",
}
PINNED = {
    "completion": "f9c14d3cd0",
    "fused": "05cb50b4dd",
    "lidar": "3ca9b5abff",
    "mono": "321a4ec779",
    "stereo": "f8555406e4",
}


@pytest.mark.parametrize("name", methods.names())
def test_keys_are_what_they_were(name: str) -> None:
    """Where this fails, every cache of this method gets a new folder name.

    A renamed field leaves its old name in ALIASES, and nothing changes here. Where a field was added, or VERSION was
    raised because the maps changed, the new key is right: pin it.
    """
    kind = methods.config_type(name)
    manifest = KNOWN | {"method": name, "version": kind.VERSION, "config": record(kind())}
    assert keys.key(manifest, kind) == PINNED[name]


@dataclass(frozen=True)
class Constant(Method):
    """Depth is a constant, whatever its fields are called; all of these are versions of one method."""

    @property
    def name(self) -> str:
        return "plane"

    @property
    def reads(self) -> tuple[Input, ...]:
        return ("image",)

    def resolve(self, frame: Frame) -> Any:
        return self

    def __call__(self, frame: Frame) -> Depth:
        return Depth(np.full(SIZE, 5.0, np.float32))


@dataclass(frozen=True)
class Plane(Constant):
    """A method as it was."""

    depth_m: float = 5.0
    tilt: float = 0.0


@dataclass(frozen=True)
class Place:
    """Where the plane is."""

    depth_m: float = 5.0


@dataclass(frozen=True)
class Renamed(Constant):
    """The same, its fields moved and renamed."""

    place: Place = field(default_factory=Place)
    slope: float = 0.0

    ALIASES: ClassVar[Aliases] = {"depth_m": "place.depth_m", "tilt": "slope"}


@dataclass(frozen=True)
class Grown(Plane):
    """The same with one more field, that does nothing by default."""

    roll: float = 0.0


@dataclass(frozen=True)
class Changed(Plane):
    """The same, but the maps have changed."""

    VERSION: ClassVar[int] = 2


def prepared(method: Any, folder: Path) -> cache.Prior:
    return build.prepare(Line(), method, folder=folder).prior


def built(method: Any, folder: Path) -> build.BuildReport:
    return build.prepare(Line(), method, folder=folder).run()


def test_renamed_fields_leave_the_key_alone(tmp_path: Path) -> None:
    before, after = prepared(Plane(6.0, 0.5), tmp_path), prepared(Renamed(Place(6.0), 0.5), tmp_path)
    assert before.folder == after.folder
    assert after.manifest["config"] == {"place": {"depth_m": 6.0}, "slope": 0.5}
    assert prepared(Renamed(Place(0.5), 6.0), tmp_path).folder != before.folder


@pytest.mark.parametrize("later", [Renamed(Place(6.0)), Grown(6.0)], ids=["renamed", "grown"])
def test_a_cache_under_another_key_is_gone_on_with(tmp_path: Path, later: Any) -> None:
    """As if the key had been made of something else: only the manifest tells what the folder holds."""
    first = built(Plane(6.0), tmp_path).prior
    old = first.folder.rename(first.folder.with_name("plane-0000000000"))
    manifest = json.loads((old / "manifest.json").read_text())
    del manifest["version"]  # as before methods had versions of their own
    (old / "manifest.json").write_text(json.dumps(manifest | {"key": "0000000000", "code": "0.0.1"}))
    (old / "depth" / "000007.png").unlink()
    report = built(later, tmp_path)
    assert report.prior.folder == old
    assert [line["id"] for line in report.built] == ["000007"]
    assert [path.name for path in old.parent.iterdir()] == [old.name]
    told = json.loads((old / "manifest.json").read_text())
    assert told["key"] == "0000000000", "the folder's own"
    assert told["config"] == record(later)
    assert not built(later, tmp_path).built


def test_changed_maps_are_made_anew(tmp_path: Path) -> None:
    before = built(Plane(), tmp_path).prior
    after = built(Changed(), tmp_path)
    assert after.prior.folder != before.folder
    assert len(after.built) == 10


@pytest.mark.parametrize("name", keys.DECIDES)
def test_whatever_decides_the_maps_tells_caches_apart(tmp_path: Path, name: str) -> None:
    prior = built(Plane(), tmp_path).prior
    other = prior.manifest | {name: {"depth_m": 7.0} if name == "config" else "other"}
    assert keys.find(prior.folder.parent, prior.manifest, Plane) is not None
    assert keys.find(prior.folder.parent, other, Plane) is None
    assert keys.key(other, Plane) != keys.key(prior.manifest, Plane)


@pytest.mark.parametrize("name", ["code", "drive", "key"])
def test_what_decides_nothing_does_not(tmp_path: Path, name: str) -> None:
    prior = built(Plane(), tmp_path).prior
    other = prior.manifest | {name: "other"}
    assert keys.find(prior.folder.parent, other, Plane) is not None
    assert keys.key(other, Plane) == keys.key(prior.manifest, Plane)


@pytest.mark.parametrize(
    "text", ["{", '{"format": 99}', '{"format": 1, "method": "plane", "drive": {"name": "x"}, "key": ""}']
)
def test_a_neighbour_that_cannot_be_read_is_left_alone(tmp_path: Path, text: str) -> None:
    stray = tmp_path / "line" / "plane-stray" / "manifest.json"
    stray.parent.mkdir(parents=True)
    stray.write_text(text)
    assert len(built(Plane(), tmp_path).built) == 10
    assert stray.read_text() == text
