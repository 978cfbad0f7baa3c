"""Flags under earlier names: they work, say in a line what they are called now, and change nothing else."""

from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import pytest
import tyro

from cli.arguments import parse
from cli.renamed import translate
from priors.records import Aliases


@dataclass(frozen=True)
class Network:
    """A group whose flags stand among its owner's."""

    model: str = "classical"
    fast: bool = False

    ALIASES: ClassVar[Aliases] = {"quick": "fast"}


@dataclass(frozen=True)
class Stereo:
    """A group of flags: --stereo.*."""

    network: Annotated[Network, tyro.conf.arg(name="")] = field(default_factory=Network)
    shift_px: float | None = None
    tilt_px: float | None = None
    yaw_px: float | None = None
    fill_holes: bool = True
    spare: Network = field(default_factory=Network)

    ALIASES: ClassVar[Aliases] = {
        "model": "network.model",
        "offset_px": ("shift_px", "tilt_px", "yaw_px"),
        "fill": "fill_holes",
        "second_model": "spare.model",
    }


@dataclass(frozen=True)
class Losses:
    """A group whose flags have no prefix."""

    depth_weight: float = 0.1

    ALIASES: ClassVar[Aliases] = {"lambda_depth": "depth_weight", "depth_lambda": "depth_weight"}


@dataclass(frozen=True)
class Arguments:
    """A command's arguments."""

    data: tyro.conf.Positional[str]
    steps: int = 1
    stereo: Stereo = field(default_factory=Stereo)
    losses: tyro.conf.OmitArgPrefixes[Losses] = field(default_factory=Losses)

    ALIASES: ClassVar[Aliases] = {"iterations": "steps"}


EARLIER = [
    ("--iterations 3", "--steps 3", "--iterations is now --steps"),
    ("--iterations=3", "--steps=3", "--iterations is now --steps"),
    ("--lambda-depth 2 --steps 4", "--depth-weight 2 --steps 4", "--lambda-depth is now --depth-weight"),
    ("--depth_lambda 2", "--depth-weight 2", "--depth_lambda is now --depth-weight"),
    ("--stereo.second-model x", "--stereo.spare.model x", "--stereo.second-model is now --stereo.spare.model"),
    ("--stereo.fill", "--stereo.fill-holes", "--stereo.fill is now --stereo.fill-holes"),
    ("--stereo.no-fill", "--stereo.no-fill-holes", "--stereo.no-fill is now --stereo.no-fill-holes"),
    ("--stereo.quick", "--stereo.fast", "--stereo.quick is now --stereo.fast"),
    ("--stereo.spare.no-quick", "--stereo.spare.no-fast", "--stereo.spare.no-quick is now --stereo.spare.no-fast"),
]
OFFSET = "--stereo.offset-px is now --stereo.shift-px --stereo.tilt-px --stereo.yaw-px"
SPLIT = [
    ("--stereo.offset-px 0.5 0 -1.1", "--stereo.shift-px 0.5 --stereo.tilt-px 0 --stereo.yaw-px -1.1", OFFSET),
    ("--stereo.offset-px 0.5 --steps 4", "--stereo.shift-px 0.5 --steps 4", OFFSET),
    ("--stereo.offset-px=0.5", "--stereo.shift-px 0.5", OFFSET),
    ("--stereo.offset-px None --steps 4", "--steps 4", OFFSET),
]


@pytest.mark.parametrize(("old", "new", "told"), EARLIER + SPLIT, ids=[old for old, _, _ in EARLIER + SPLIT])
def test_an_earlier_flag_works_and_says_its_new_name(
    old: str, new: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert translate(Arguments, ["x", *old.split()]) == ["x", *new.split()]
    assert capsys.readouterr().err.splitlines() == [told]
    found: Any = parse(Arguments, "test", "", ["x", *old.split()])
    capsys.readouterr()
    assert found == parse(Arguments, "test", "", ["x", *new.split()])
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("order", ["x --stereo.offset-px 0.5 0", "--stereo.offset-px 0.5 0 1 x"])
def test_what_follows_the_numbers_is_left_alone(order: str) -> None:
    assert "x" in translate(Arguments, order.split())
    assert parse(Arguments, "test", "", order.split()).data == "x"


@pytest.mark.parametrize(
    "words", ["", "--steps 3", "--stereo.model cfnet", "iterations", "--no-such-flag", "--stereo.shift-px=-1", "-- --x"]
)
def test_flags_of_today_are_left_alone(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert translate(Arguments, words.split()) == words.split()
    assert capsys.readouterr().err == ""


def test_a_moved_field_whose_flag_stays_is_no_news(capsys: pytest.CaptureFixture[str]) -> None:
    assert parse(Arguments, "test", "", ["x", "--stereo.model", "cfnet"]).stereo.network.model == "cfnet"
    assert capsys.readouterr().err == ""
