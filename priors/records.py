"""Records: a config as JSON holds it, and how one is read after its fields were renamed.

A config is a frozen dataclass; manifests, runs and checkpoints hold its record. Where a field is renamed, moved or
split, its old name stays beside the dataclass, oldest first:

    ALIASES: ClassVar[Aliases] = {
        "width": "neurons",                     renamed
        "model": "network.model",               moved into the nested config `network`
        "offset_px": ("shift_px", "tilt_px"),   a list of numbers before, now one field a number
    }

Old records are then read as before, keys stay what they were, and flags work under both names (cli/renamed.py). An old
name is never the name of a field of today.

Where a new field, or a field's new default, changes what comes out, what earlier versions did stands beside it:

    BEFORE: ClassVar[Mapping[str, Any]] = {"terminate": 0.0}

A record that lacks the field is of an earlier version, and is read with that value: its results go on as they were.
A key leaves such a value out, so that what earlier versions made keeps its key.

A field that is gone stands there with the value in which today's version goes on:

    GONE: ClassVar[Mapping[str, Any]] = {"robust": False}

A record with that value is read as if it had none; one with another value is not known to this version.
"""

from collections.abc import Mapping
from dataclasses import MISSING, Field, asdict, fields, is_dataclass, replace
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeAlias, TypeVar, Union, get_args, get_origin, get_type_hints

Aliases: TypeAlias = Mapping[str, str | tuple[str, ...]]
"""A field's old name -> where its value is now; dots lead into nested configs."""
Record: TypeAlias = dict[str, Any]
Config = TypeVar("Config")


def record(config: Any) -> Record:
    """Return a config as JSON holds it; of a file only the name, since what it holds decides and not where it lies."""
    return _plain(asdict(config))


def aliases(kind: type[Any]) -> Aliases:
    """Return the old names of a config's fields; most configs have none, and say nothing."""
    return getattr(kind, "ALIASES", {})


def before(kind: type[Any]) -> Mapping[str, Any]:
    """Return what fields were in effect before they were there or had today's default; most configs say nothing."""
    return getattr(kind, "BEFORE", {})


def earlier(config: Config, begun: Config) -> Config:
    """Return what the version that began something made of the same wishes.

    A field at today's default is as it was begun, where that is what an earlier version did: some earlier versions had
    a part of today's defaults.
    """
    changes: Record = {}
    for field in fields(config):  # type: ignore[arg-type]
        value, old = getattr(config, field.name), getattr(begun, field.name)
        if is_dataclass(value) and type(old) is type(value):
            changes[field.name] = earlier(value, old)
        elif field.name in before(type(config)) and value == field.default and old == before(type(config))[field.name]:
            changes[field.name] = old
    return replace(config, **changes)  # type: ignore[type-var]


def upgrade(kind: type[Any], old: Record) -> Record:
    """Return a record in today's names; a field that it lacks has its default, where there is one."""
    new = dict(before(kind)) | _renamed(kind, old)
    for field in fields(kind):
        if field.name not in new and (default := _default(field)) is not MISSING:
            new[field.name] = default
    for name, nested in _nested(kind, new):
        new[name] = upgrade(nested, new[name])
    return new


def original(kind: type[Any], new: Record) -> Record:
    """Return a record of today as earlier versions had it: what keys are made of; `upgrade` undoes it.

    Fields have the names that they had first; a new field that changes nothing is left out.
    """
    old = {name: value for name, value in _plain(new).items() if not _is_before(kind, name, value)}
    for name, place in aliases(kind).items():
        parts = (place,) if isinstance(place, str) else place
        values = [_take(old, part) for part in parts]
        if all(value is MISSING for value in values):
            continue  # an older name has it
        old[name] = values[0] if isinstance(place, str) else None if values == [None] * len(values) else values
    for name, nested in _nested(kind, old):
        old[name] = original(nested, old[name])
        if not old[name]:  # all of it was beside the others before
            del old[name]
    return old


def restore(kind: type[Config], old: Record) -> Config:
    """Make a config of its record.

    Raises:
        TypeError: a value without a default is missing, or there is one that this version does not know.
        DataError: the config refuses a value.
    """
    new, hints = dict(before(kind)) | _renamed(kind, old), get_type_hints(kind)
    unknown = new.keys() - {field.name for field in fields(kind)}  # type: ignore[arg-type]
    if unknown:
        raise TypeError(f"{min(unknown)} is not known to this version")
    return kind(**{name: _typed(hints[name], value) for name, value in new.items()})


def nested_config(hint: Any) -> type[Any] | None:
    """Return the config that a field of this type holds: for `C` itself, `C | None` and `Annotated[C, ...]`."""
    if get_origin(hint) in (Annotated, Union, UnionType):
        return next((config for part in get_args(hint) if (config := nested_config(part))), None)
    return hint if isinstance(hint, type) and is_dataclass(hint) else None


def _is_before(kind: type[Any], name: str, value: Any) -> bool:
    """Tell whether a field has the value that earlier versions, which did not have it, are read with."""
    return name in before(kind) and value == _plain(before(kind)[name])


def _renamed(kind: type[Any], old: Record) -> Record:
    """Return a record whose own entries have today's names; those of nested configs are left as they are."""
    new: Record = {}
    gone = getattr(kind, "GONE", {})
    for name, value in _plain(old).items():
        if name in gone and value == gone[name]:
            continue
        place = aliases(kind).get(name, name)
        if isinstance(place, str):
            _put(new, place, value)
        elif value is not None:
            for part, number in zip(place, value, strict=False):
                _put(new, part, number)
    return new


def _nested(kind: type[Any], of: Record) -> list[tuple[str, type[Any]]]:
    """List the entries that are records of nested configs, with their types."""
    configs = [(name, nested_config(hint)) for name, hint in get_type_hints(kind).items()]
    return [(name, config) for name, config in configs if config is not None and isinstance(of.get(name), dict)]


def _put(into: Record, path: str, value: Any) -> None:
    *above, name = path.split(".")
    for part in above:
        into = into.setdefault(part, {})
    into[name] = value


def _take(out_of: Record, path: str) -> Any:
    """Remove a value; MISSING where it is not there."""
    *above, name = path.split(".")
    for part in above:
        out_of = out_of.get(part) or {}
    return out_of.pop(name, MISSING)


def _default(field: Field[Any]) -> Any:
    """Return a field's default as a record holds it, or MISSING."""
    if field.default_factory is not MISSING:
        return _plain(field.default_factory())
    return _plain(field.default)


def _plain(value: Any) -> Any:
    """Turn what a config holds into what JSON holds."""
    if isinstance(value, Path):
        return value.name
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    return record(value) if is_dataclass(value) and not isinstance(value, type) else value


def _typed(hint: Any, value: Any) -> Any:
    """Turn what JSON holds into what a field of this type holds."""
    nested, kinds = nested_config(hint), {get_origin(part) or part for part in (hint, *get_args(hint))}
    if nested is not None and value is not None:
        if not isinstance(value, dict):
            raise TypeError(f"expected the fields of {nested.__name__}, found {value!r:.40}")
        return restore(nested, value)
    if isinstance(value, str) and Path in kinds:
        return Path(value)
    return _tuples(value) if tuple in kinds else value


def _tuples(value: Any) -> Any:
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
