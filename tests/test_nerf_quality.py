"""What `nerf fit` trains, and how long, where nobody says."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cli.arguments import parse
from cli.nerf.fit import FitArguments
from nerf import fields
from nerf.config import FitConfig, ModelConfig
from priors.records import earlier, restore


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


def test_runs_of_earlier_versions_keep_their_batches() -> None:
    begun = restore(FitConfig, {"rays": 2048})
    assert [begun.rays_at(progress, 4.0) for progress in (0, 0.5, 1)] == [2048] * 3
    assert earlier(FitConfig(rays=2048), begun).rays_growth == 1
    assert typed("--rays", "2048").rays_at(1, 4.0) == 4 * 2048
    assert typed("--rays", "2048", "--rays-growth", "1").rays_at(1, 4.0) == 2048


@given(st.integers(1, 32), st.integers(1, 8), st.floats(1, 64), st.floats(0, 1))
def test_processes_have_together_what_one_has(rays: int, processes: int, growth: float, progress: float) -> None:
    """Of so many rays that sixteenths are whole: each process of r rays has its part of what one of N r has."""
    each = FitConfig(rays=16 * rays, rays_growth=growth)
    assert processes * each.rays_at(progress, 1.0) == FitConfig(rays=16 * rays * processes, rays_growth=growth).rays_at(
        progress, 1.0
    )
    assert each.rays <= each.rays_at(progress, 1.0) <= each.rays * growth * (1 + 1 / 16)
