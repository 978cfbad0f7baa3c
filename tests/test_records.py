"""Records: what was written under earlier names is read again, and keys keep the names that fields had first."""

import dataclasses
import importlib
import pkgutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, get_type_hints

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import cli
import nerf
import priors
from priors.records import Aliases, aliases, earlier, nested_config, original, record, restore, upgrade


@dataclass(frozen=True)
class Network:
    """What was beside the others before."""

    model: str = "classical"
    weights: Path | None = None
    neurons: int = 64

    ALIASES: ClassVar[Aliases] = {"width": "neurons"}


@dataclass(frozen=True)
class Today:
    """A config all of whose fields were called otherwise."""

    reach: float = 0.1
    shift_px: float | None = None
    tilt_px: float | None = None
    spans: tuple[tuple[float, float], ...] = ()
    network: Network = field(default_factory=Network)
    second: Network | None = None

    ALIASES: ClassVar[Aliases] = {
        "reach_share": "reach",
        "band": "reach",
        "offset_px": ("shift_px", "tilt_px"),
        "model": "network.model",
        "weights": "network.weights",
        "neurons": "network.neurons",
    }


FRESH = record(Today())
NETWORK = FRESH["network"]
EARLIER = [
    ({}, {}),
    ({"reach_share": 0.3}, {"reach": 0.3}),
    ({"band": 0.3}, {"reach": 0.3}),
    ({"reach": 0.3}, {"reach": 0.3}),
    ({"offset_px": [0.5, -1.0]}, {"shift_px": 0.5, "tilt_px": -1.0}),
    ({"offset_px": [0.5]}, {"shift_px": 0.5}),
    ({"offset_px": None}, {}),
    ({"model": "cfnet"}, {"network": NETWORK | {"model": "cfnet"}}),
    ({"network": {"model": "cfnet"}}, {"network": NETWORK | {"model": "cfnet"}}),
    ({"network": {"width": 16}}, {"network": NETWORK | {"neurons": 16}}),
    ({"model": "cfnet", "neurons": 16}, {"network": NETWORK | {"model": "cfnet", "neurons": 16}}),
    ({"second": {"width": 16}}, {"second": NETWORK | {"neurons": 16}}),
    ({"of_tomorrow": 3}, {"of_tomorrow": 3}),
]


@pytest.mark.parametrize(("old", "changes"), EARLIER, ids=[str(old) for old, _ in EARLIER])
def test_an_earlier_record_is_read_in_todays_names(old: dict[str, Any], changes: dict[str, Any]) -> None:
    assert upgrade(Today, old) == FRESH | changes


def test_reading_changes_nothing_of_what_is_read() -> None:
    old = {"network": {"width": 16}, "model": "cfnet", "second": {"width": 8}}
    upgrade(Today, old)
    assert old == {"network": {"width": 16}, "model": "cfnet", "second": {"width": 8}}
    today = record(Today(second=Network()))
    original(Today, today)
    assert today == record(Today(second=Network()))


def test_the_first_names_are_those_that_stand_first() -> None:
    first = original(Today, record(Today(shift_px=0.5, tilt_px=1.0, network=Network("cfnet", Path("a/b.onnx"), 16))))
    assert first == {
        "reach_share": 0.1,
        "offset_px": [0.5, 1.0],
        "spans": [],
        "model": "cfnet",
        "weights": "b.onnx",
        "neurons": 16,
        "second": None,
    }


@dataclass(frozen=True)
class Later(Network):
    """The same with fields that earlier versions had not, of which one does nothing as it was before."""

    headroom: float = 1.25
    rows_px: float | None = None

    BEFORE: ClassVar[Mapping[str, Any]] = {"headroom": 1.0, "rows_px": None}


def test_a_new_field_that_does_nothing_is_not_in_the_first_record() -> None:
    assert original(Later, record(Later(headroom=1.0))) == original(Network, record(Network()))
    assert original(Later, record(Later())) == original(Network, record(Network())) | {"headroom": 1.25}
    for config in (Later(), Later(headroom=1.0), Later(rows_px=0.0), Later(rows_px=2.5, headroom=1.0)):
        assert restore(Later, original(Later, record(config))) == config
    assert upgrade(Later, record(Network())) == record(Later(headroom=1.0))


whatever_the_load = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
px = st.floats(-5, 5)
networks = st.builds(Network, st.text(), st.none() | st.just(Path("w.onnx")), st.integers())
spans = st.lists(st.tuples(px, px), max_size=3).map(tuple)
# Two numbers or none: half of an offset is a list that is shorter, which does not say what the rest was.
configs = st.tuples(px, st.none() | st.tuples(px, px), spans, networks, st.none() | networks).map(
    lambda made: Today(made[0], *(made[1] or (None, None)), *made[2:])
)


@whatever_the_load
@given(configs)
def test_what_is_written_under_any_names_makes_the_same_config(config: Today) -> None:
    today = record(config)
    assert upgrade(Today, today) == today
    assert upgrade(Today, original(Today, today)) == today
    assert restore(Today, today) == config
    assert restore(Today, original(Today, today)) == config


@whatever_the_load
@given(configs, configs)
def test_other_configs_have_other_first_records(one: Today, two: Today) -> None:
    assert (original(Today, record(one)) == original(Today, record(two))) == (record(one) == record(two))


def test_what_cannot_be_restored_is_told() -> None:
    @dataclass(frozen=True)
    class Needy:
        """A config that cannot do without a value."""

        name: str
        network: Network = field(default_factory=Network)

    assert restore(Needy, {"name": "a"}) == Needy("a")
    with pytest.raises(TypeError, match="name"):
        restore(Needy, {})
    with pytest.raises(TypeError, match="colour is not known to this version"):
        restore(Needy, {"name": "a", "colour": 3})
    with pytest.raises(TypeError, match="expected the fields of Network, found 3"):
        restore(Needy, {"name": "a", "network": 3})


def modules(package: ModuleType) -> Iterator[ModuleType]:
    """Import what a package holds, but for what needs a GPU's compiler."""
    for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        if "triton" not in found.name:
            yield importlib.import_module(found.name)


def test_every_old_name_of_ours_leads_to_a_field_and_is_none() -> None:
    kinds = {
        kind
        for package in (priors, nerf, cli)
        for module in modules(package)
        for kind in vars(module).values()
        if isinstance(kind, type) and dataclasses.is_dataclass(kind)
    }
    assert len(kinds) > 100
    for kind in kinds:
        today = {each.name for each in fields(kind)}
        for old, place in aliases(kind).items():
            assert old not in today, f"{kind.__name__}: {old} is a field"
            for path in (place,) if isinstance(place, str) else place:
                holder, *rest = kind, *path.split(".")
                for name in rest:
                    assert holder is not None and name in {each.name for each in fields(holder)}, f"{old} -> {path}"
                    holder = nested_config(get_type_hints(holder)[name])


@dataclass(frozen=True)
class Grown:
    """A config with a field that changed what came out."""

    old: int = 1
    fresh: float = 0.5
    inner: Network = field(default_factory=Network)

    BEFORE: ClassVar[Mapping[str, Any]] = {"fresh": 0.0}


@dataclass(frozen=True)
class Around:
    """A config around it."""

    grown: Grown = field(default_factory=Grown)


def test_a_record_from_before_a_field_is_read_as_it_was() -> None:
    assert restore(Grown, {"old": 2}) == Grown(2, 0.0)
    assert restore(Around, {"grown": {"old": 2}}) == Around(Grown(2, 0.0))
    assert restore(Around, record(Around())) == Around(Grown(1, 0.5))
    assert upgrade(Grown, {"old": 2})["fresh"] == 0.0


def test_a_field_that_is_gone_is_read_where_it_changed_nothing() -> None:
    @dataclass(frozen=True)
    class Smaller:
        kept: int = 1
        GONE: ClassVar[Mapping[str, Any]] = {"lost": False}

    assert restore(Smaller, {"kept": 2, "lost": False}) == Smaller(2)
    assert upgrade(Smaller, {"kept": 2, "lost": False}) == {"kept": 2}
    with pytest.raises(TypeError, match="lost is not known to this version"):
        restore(Smaller, {"kept": 2, "lost": True})


def test_a_config_goes_on_as_an_earlier_version_began_it() -> None:
    begun = Around(Grown(2, 0.0))
    assert earlier(Around(), begun) == Around(Grown(1, 0.0))
    assert earlier(Around(), Around()) == Around(), "begun by this version"
    assert earlier(Around(), Around(Grown(fresh=0.3))) == Around(), "no version did that by default"
    assert earlier(Around(Grown(fresh=0.7)), begun) == Around(Grown(fresh=0.7)), "what was asked for stays"


def test_versions_that_had_a_part_of_todays_defaults_go_on() -> None:
    @dataclass(frozen=True)
    class Twice:
        first: int = 1
        second: int = 2
        BEFORE: ClassVar[Mapping[str, Any]] = {"first": 10, "second": 20}

    for begun in (Twice(), Twice(1, 20), Twice(10, 20)):
        assert earlier(Twice(), begun) == begun
