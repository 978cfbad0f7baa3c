"""Mistyped arguments are answered in one line; text is printed as it is, on any stream."""

import io
from dataclasses import dataclass, field

import pytest

from cli import mistakes, owners
from cli.nerf import PROGRAM as NERF
from cli.priors import PROGRAM as PRIORS
from cli.program import Program
from cli.stand_ins import say_plainly, stand_in
from cli.terminal import Screen
from priors.errors import UsageError


@dataclass(frozen=True)
class Inner:
    model: str = "small"
    fill: bool = True


@dataclass(frozen=True)
class Outer:
    size_px: int = 3
    stereo: Inner = field(default_factory=Inner)


def wrong(*words: str) -> str:
    with pytest.raises(UsageError) as caught:
        mistakes.parse(Outer, "priors x", "", words)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_the_nearest_flag_is_told() -> None:
    assert wrong("--sise-px", "3") == "priors x has no flag --sise-px: did you mean --size-px?"
    assert wrong("--stero.model=m").endswith("did you mean --stereo.model?")
    assert wrong("--zzzzzzzzz").endswith("see priors x --help")


@pytest.mark.parametrize(
    ("command", "words", "says"),
    [
        (
            "priors build",
            ["--steps", "3"],
            "has no flag --steps: a flag of nerf fit, nerf video, nerf study and ",
        ),
        (
            "priors check",
            ["--no-truth-mask"],
            "has no flag --no-truth-mask: a flag of priors build, priors export, nerf fit and ",
        ),
        ("priors eval", ["--threads", "3"], "a flag of priors build, priors bench, priors plan and "),
        ("nerf fit", ["--stereo.model=cfnet"], "a flag of priors build"),
        ("nerf eval", ["--voxel_m", "1"], "a flag of nerf export"),
        ("nerf render", ["--net", "x"], "a flag of priors export and priors train"),
        ("priors train mono", ["--net", "x"], "a flag of priors train stereo and priors export"),
        ("priors build", ["--method", "stereo", "--model", "cfnet"], "did you mean --stereo.model?"),
        ("priors build", ["--sweeps", "3"], "--completion.lidar.sweeps or --fused.completion.lidar.sweeps or "),
        ("priors build", ["--method", "fused", "--model", "cfnet"], "did you mean --fused.completion.model or "),
        ("priors show", ["--frame", "3"], "did you mean --frames?"),
        ("priors train stereo", ["--minute", "3"], "did you mean --minutes?"),
    ],
)
def test_a_flag_says_whose_it_is(command: str, words: list[str], says: str) -> None:
    kind = owners.arguments_of(command.split()[0])[command]
    with pytest.raises(UsageError) as caught:
        mistakes.refuse_unknown(kind, command, words)
    assert says in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("program", "word", "says"),
    [
        (PRIORS, "fit", "priors has no command 'fit': it is nerf fit"),
        (NERF, "build", "nerf has no command 'build': it is priors build"),
        (NERF, "list", "it is priors list"),
        (PRIORS, "--frames", "a command comes first: priors COMMAND --frames"),
        (PRIORS, "chekc", "did you mean check?"),
    ],
)
def test_a_command_says_whose_it_is(program: Program, word: str, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert program.run([word]) == 2
    assert says in capsys.readouterr().err


@pytest.mark.parametrize(("words", "said"), [(["--size-px"], "--size-px"), (["--size-px", "a"], "'a'"), (["y"], "y")])
def test_what_is_wrong_is_named(words: list[str], said: str) -> None:
    assert said in wrong(*words)


@pytest.mark.parametrize("words", [["--stereo.model", ""], ["--stereo.model="], [""]])
def test_an_empty_word_is_no_folder(words: list[str]) -> None:
    assert "found nothing" in wrong(*words)


def test_what_is_right_is_parsed() -> None:
    assert mistakes.parse(Outer, "priors x", "", ["--size_px", "4", "--stereo.no-fill"]) == Outer(4, Inner(fill=False))


def test_the_nearest_command_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    assert Program("priors", "", {"build": ""}, "").run(["biuld"]) == 2
    assert "did you mean build?" in capsys.readouterr().err


@pytest.mark.parametrize("encoding", ["cp1252", "ascii", "latin-1"])
def test_a_stream_says_stand_ins(encoding: str) -> None:
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding)
    say_plainly((stream, None))
    print("AbsRel ↓ δ<1.25² ☃ \udcff", file=stream, flush=True)
    told = raw.getvalue().decode(encoding)
    assert told.startswith("AbsRel v d<1.25")
    assert "\\u2603" in told and "\\xff" in told


def test_every_stand_in_is_ascii() -> None:
    for character in "↑→δ²é☃\udc80":
        stand_in(character).encode("ascii")


def test_square_brackets_are_printed_as_they_are() -> None:
    said = io.StringIO()
    screen = Screen(file=said, width=80)
    for name in ("cache [v2]", "[/x]", "[bold]", ":smile:"):
        screen.print(f"wrote {name}")
        screen.complain(name, name)
    assert said.getvalue().splitlines()[:4] == [
        "wrote cache [v2]",
        "cache [v2]: cache [v2]",
        "wrote [/x]",
        "[/x]: [/x]",
    ]
    assert "[bold]" in said.getvalue() and ":smile:" in said.getvalue()
