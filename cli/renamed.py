"""Flags under their earlier names: they work for one version, and a line on stderr tells what they are called now.

A field's old names stand beside its config (priors/records.py); the same lines serve manifests and runs.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from typing import Any, get_args, get_type_hints

import tyro

from cli.console import err
from priors.records import aliases, nested_config

_NO_PREFIX = get_args(tyro.conf.OmitArgPrefixes[int])[1]
_Named: Any = type(tyro.conf.arg())


@dataclass(frozen=True)
class _Group:
    """A config among a command's arguments."""

    kind: type[Any]
    path: str
    """Where it is: "stereo." or "" for the command's own."""
    prefix: str
    """What its flags begin with: "stereo." or "" where the prefix is left out."""


def translate(kind: type[Any], arguments: list[str]) -> list[str]:
    """Return a command's arguments with today's flags; each flag under an earlier name is told on stderr."""
    renamed, words, out = dict(_renamed(kind)), list(arguments), []
    while words:
        word = words.pop(0)
        flag, equals, value = word.partition("=")
        now = renamed.get(flag.replace("_", "-"), ())
        if not now:
            out.append(word)
            continue
        err.print(f"{flag} is now {' '.join(now)}")
        if len(now) == 1:
            out.append(now[0] + equals + value)
        else:
            numbers = [value] if equals else _take_numbers(words, len(now))
            out += [part for pair in zip(now, numbers, strict=False) for part in pair]
    return out


def groups(kind: type[Any]) -> list[tuple[type[Any], str]]:
    """Return the configs among a command's arguments, its own first, and what their flags begin with."""
    return [(group.kind, group.prefix) for group in _groups(_Group(kind, "", ""))]


def flags_of(kind: type[Any]) -> set[str]:
    """Return the flags of a command's arguments, without the dashes; positional arguments are among them."""
    return set(_flags(_groups(_Group(kind, "", ""))).values())


def negated(flag: str) -> str:
    """Return what switches a flag off: stereo.no-flag."""
    prefix, dot, name = flag.rpartition(".")
    return f"{prefix}{dot}no-{name}"


def _take_numbers(words: list[str], most: int) -> list[str]:
    """Remove the numbers that a flag was given, or None, from the words after it; returns the numbers."""
    if words[:1] == ["None"]:
        del words[0]
    count = 0
    while count < min(most, len(words)) and _is_number(words[count]):
        count += 1
    taken, words[:] = words[:count], words[count:]
    return taken


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _renamed(kind: type[Any]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Yield earlier flags and what they are called now; those that are flags of today too are not renamed."""
    groups = list(_groups(_Group(kind, "", "")))
    flags = _flags(groups)
    today = set(flags.values())
    for group in groups:
        for old, place in aliases(group.kind).items():
            was = group.prefix + old.replace("_", "-")
            now = [flags[group.path + part] for part in ((place,) if isinstance(place, str) else place)]
            if was not in today:
                yield f"--{was}", tuple(f"--{flag}" for flag in now)
                if len(now) == 1:
                    yield f"--{negated(was)}", (f"--{negated(now[0])}",)


def _flags(groups: Iterable[_Group]) -> dict[str, str]:
    """Return what each field is called as a flag, by where it is: "stereo.offset_px" -> "stereo.offset-px"."""
    return {
        group.path + field.name: group.prefix + field.name.replace("_", "-")
        for group in groups
        for field in fields(group.kind)
    }


def _groups(group: _Group) -> Iterator[_Group]:
    """Yield a config and those nested in it."""
    yield group
    for name, hint in get_type_hints(group.kind, include_extras=True).items():
        nested = nested_config(hint)
        if nested is not None:
            yield from _groups(_Group(nested, f"{group.path}{name}.", _prefix(group.prefix, name, hint)))


def _prefix(above: str, name: str, hint: Any) -> str:
    """Return what the flags of a nested config begin with, as tyro has it."""
    marks: tuple[Any, ...] = get_args(hint)[1:]
    if _NO_PREFIX in marks:
        return ""
    own = next((mark.name for mark in marks if isinstance(mark, _Named) and mark.name is not None), name)
    return above + (f"{own.replace('_', '-')}." if own else "")
