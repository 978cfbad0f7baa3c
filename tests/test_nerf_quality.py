"""What `nerf fit` trains, and how long, where nobody says."""

import pytest

from cli.arguments import parse
from cli.nerf.fit import FitArguments
from nerf import fields
from nerf.config import FitConfig, ModelConfig


def typed(*words: str) -> FitConfig:
    """The settings of `nerf fit street ...`."""
    return parse(FitArguments, "nerf fit", "", ["street", *words]).config()


@pytest.mark.parametrize(("quality", "seconds"), [("fast", 10), ("default", 60), ("high", 300)])
def test_a_quality_is_a_time(quality: str, seconds: float) -> None:
    assert typed("--quality", quality).seconds == seconds
    assert typed("--quality", quality, "--time", "2m").seconds == 120
    asked = typed("--quality", quality, "--steps", "7")
    assert (asked.steps, asked.seconds) == (7, None)


def test_auto_is_a_family_and_the_default_of_program_and_command() -> None:
    assert typed() == typed("--field", "auto", "--quality", "default") == FitConfig()
    assert ModelConfig().family in fields.names()
    assert typed("--field", "ngp").model.family == "ngp"
