"""The choice of `--field auto`: by what was asked for, then by what the checked prior shows."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nerf.choice import DENSE, by_scene, by_settings, covered
from nerf.config import FitConfig, ModelConfig
from nerf.evidence.check import Checked
from nerf.evidence.finding import Finding
from nerf.gaussians.config import GaussianConfig
from nerf.prepare import SceneConfig
from nerf.run import choose
from nerf.sample import SamplerConfig
from nerf.scene import Scene
from priors.drives import open_drive
from tests.nerf_commands import nerf, prior_of, refused
from tests.test_nerf_fit import corridor


@pytest.fixture(scope="module")
def scene() -> Scene:
    return corridor(count=6)


def thinned(scene: Scene, share: float) -> Scene:
    """Keep a share of the prior's values, drawn at random."""
    assert scene.depth_m is not None
    random = np.random.default_rng(0)
    maps = np.stack([np.asarray(scene.depth_m[position]) for position in range(len(scene.ids))])
    return replace(
        scene, depth_m=np.where(random.random(maps.shape) < share, np.maximum(maps, 1), 0), weight=None, sky=None
    )


def test_a_dense_prior_is_for_gaussians_and_a_sparse_one_is_not(scene: Scene) -> None:
    assert by_scene(Checked(thinned(scene, 1.0), None)).family == "splat"
    sparse = by_scene(Checked(thinned(scene, 0.3), None))
    assert sparse.family == "mip360" and "30 %" in sparse.why


def test_a_prior_that_is_often_wrong_is_for_hash_fields(scene: Scene) -> None:
    dense = thinned(scene, 1.0)
    assert by_scene(Checked(dense, Finding(patches=100, wrong=0.1))).family == "splat"
    assert by_scene(Checked(dense, Finding(patches=100, wrong=0.25))).family == "mip360"


def test_depth_that_a_prior_is_not_sure_of_does_not_count(scene: Scene) -> None:
    dense = thinned(scene, 1.0)
    weight = np.full((len(scene.ids), *scene.camera.size), 255, np.uint8)
    weight[..., ::2] = 25
    unsure = replace(dense, weight=weight)
    assert covered(unsure) == pytest.approx(0.5, abs=0.02) and by_scene(Checked(unsure, None)).family == "mip360"


def test_pixels_of_the_sky_need_no_depth(scene: Scene) -> None:
    upper = np.zeros((len(scene.ids), *scene.camera.size), np.uint8)
    upper[:, : scene.camera.size[0] // 2] = 1
    half = np.where(upper, 0, 5.0).astype(np.float32)
    assert covered(replace(scene, depth_m=half, weight=None, sky=upper)) == 1
    assert covered(replace(scene, depth_m=half, weight=None, sky=None)) == pytest.approx(0.5, abs=0.1) and DENSE > 0.6


def test_a_prior_that_the_check_left_out_is_no_start(scene: Scene) -> None:
    left_out = Checked(replace(scene, depth_m=None, weight=None, sky=None), Finding(used=False))
    assert by_scene(left_out).why == "the prior is left out"
    assert by_scene(Checked(replace(scene, depth_m=None), None)).family == "mip360"


@pytest.mark.parametrize(
    ("config", "device", "why"),
    [
        (FitConfig(), "cuda", "GPU"),
        (FitConfig(align="learn"), "cpu", "--align learn"),
        (FitConfig(blocks_m=50.0), "cpu", "blocks"),
        (FitConfig(ModelConfig(width=32)), "cpu", "--width"),
        (FitConfig(ModelConfig(sampler=SamplerConfig(count=8))), "cpu", "--count"),
    ],
)
def test_what_only_hash_fields_do_is_for_hash_fields(config: FitConfig, device: str, why: str) -> None:
    chosen = by_settings(config, device)
    assert chosen is not None and chosen.family == "mip360" and why in chosen.why


def test_what_gaussians_read_leaves_the_choice_to_the_scene() -> None:
    assert by_settings(FitConfig(ModelConfig(gaussians=GaussianConfig(degree=2))), "cpu") is None


def test_a_run_says_what_was_chosen_and_goes_on_with_it(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    prior, run = prior_of(fitted), tmp_path / "run"
    flags = ("--prior", prior, "--run", run, "--device", "cpu")
    assert nerf("fit", fitted / "street", *flags, "--steps", 1, "--field", "ngp") == 0
    capsys.readouterr()
    assert nerf("fit", fitted / "street", *flags, "--steps", 2) == 0  # it has begun as ngp
    assert "field: ngp" in " ".join(capsys.readouterr().err.split())
    chosen = choose(open_drive(fitted / "street"), None, SceneConfig(), FitConfig(), tmp_path)
    assert chosen.why == "there is no prior"


def test_a_flag_that_the_chosen_family_does_not_read_is_refused(
    fitted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    told = refused(capsys, "fit", fitted / "street", "--degree", 2, "--steps", 1, "--run", tmp_path / "run")
    assert "--degree 2" in told and "--field auto took" in told
