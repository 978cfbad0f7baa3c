"""Every flag of every command refuses what it cannot be: a new flag without a check is red here."""

import math
from collections.abc import Iterator
from dataclasses import MISSING, dataclass, fields
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import pytest

from cli.nerf import PROGRAM as NERF
from cli.owners import PROGRAMS, arguments_of
from cli.priors import PROGRAM as PRIORS
from cli.renamed import groups
from priors.errors import DataError

HUGE = 10**30
WRONG: dict[type, tuple[Any, ...]] = {int: (-5, HUGE), float: (math.nan, -1.0, -math.inf), str: ("", "a:b:c:d")}
"""What no flag of a kind may take; SIGNED and NAMES are the exceptions."""
SIGNED = ("stereo.offset-px", "stereo.rows-px")
"""How flags end whose numbers may be below 0."""
NAMES = {"drive", "camera", "host"}
"""Texts that may be anything but empty."""


@dataclass(frozen=True)
class Flag:
    """A flag, and the config whose field it is."""

    config: type[Any]
    field: str
    name: str

    @property
    def kinds(self) -> set[type]:
        """Types of its values, without None; of each of them where it takes several."""
        return set(_kinds(get_type_hints(self.config)[self.field]))

    @property
    def takes_several(self) -> bool:
        """Whether its value is a tuple."""
        return any(get_origin(part) is tuple for part in _parts(get_type_hints(self.config)[self.field]))

    def make(self, value: Any) -> Any:
        """Make the config with this value, as Python code would."""
        lacking = [each for each in fields(self.config) if each.default is each.default_factory is MISSING]
        given = {each.name: Path("x") for each in lacking}
        return self.config(**given | {self.field: (value,) if self.takes_several else value})


def _parts(hint: Any) -> Iterator[Any]:
    if get_origin(hint) in (Union, UnionType, Annotated):
        for part in get_args(hint):
            yield from _parts(part)
    else:
        yield hint


def _kinds(hint: Any) -> Iterator[type]:
    for part in _parts(hint):
        if get_origin(part) is tuple:
            yield from _kinds(get_args(part)[0])
        elif isinstance(part, type) and part is not NoneType:
            yield part


def _flags() -> dict[str, Flag]:
    """Return the flags of all commands by config and name."""
    found = {}
    for kind in (kind for program in PROGRAMS for kind in arguments_of(program).values()):
        for config, prefix in groups(kind):
            for each in fields(config):
                name = prefix + each.name.replace("_", "-")
                found[f"{config.__name__} {name}"] = Flag(config, each.name, name)
    return found


FLAGS = _flags()
TRIED = [
    pytest.param(flag, value, id=f"{key} {value}")
    for key, flag in FLAGS.items()
    for kind in flag.kinds & WRONG.keys()
    for value in WRONG[kind]
    if not (flag.name.endswith(SIGNED) and isinstance(value, float) and math.isfinite(value))
    if not (flag.name in NAMES and value)
]


def test_all_commands_are_walked() -> None:
    for program in (PRIORS, NERF):
        typed = {" ".join(command.split()[:2]) for command in arguments_of(program.name)}
        assert typed == {f"{program.name} {name}" for name in program.commands}
    names = {flag.name for flag in FLAGS.values()}
    assert {"threads", "stereo.max-disparity-px", "depth-weight", "size", "lr", "fps", "voxel-m", "every"} <= names
    assert len(TRIED) > 200


@pytest.mark.parametrize(("flag", "value"), TRIED)
def test_what_a_flag_cannot_be_is_refused(flag: Flag, value: object) -> None:
    with pytest.raises(DataError) as caught:
        flag.make(value)
    assert "\n" not in str(caught.value)
