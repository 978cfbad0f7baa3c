"""`--align learn`: a frame's scale and shift are found with the field, kept, and gone on with."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from nerf import checkpoint
from nerf.alignment import PULL, SHIFT, Alignment
from nerf.config import FitConfig
from nerf.fit import Status, fit
from nerf.optimise import Optimiser, OptimiserConfig
from nerf.run import begin
from nerf.types import Rays, Rendered
from priors.drives import open_drive
from priors.errors import UsageError
from tests.test_nerf_fit import config, corridor


def seen(depth_m: torch.Tensor) -> Rendered:
    """What a field shows that is opaque at these depths (r,)."""
    clear = torch.zeros_like(depth_m)
    return Rendered(torch.zeros(len(depth_m), 3), depth_m, depth_m, clear, clear)


def test_scales_and_shifts_are_found() -> None:
    """Four frames, one of which does not train; a third of the prior is wrong by 10x."""
    random = torch.Generator().manual_seed(1)
    scale, shift = torch.tensor([1.0, 1.2, 0.8, 1.0]), torch.tensor([0.0, 0.0, 0.01, 0.0])
    alignment = Alignment(4, [0, 1, 2], "cpu")
    parameters = {f"alignment.{name}": tensor for name, tensor in alignment.parameters().items()}
    optimiser, steps = Optimiser(parameters), 200
    for step in range(steps):
        frame = torch.randint(0, 3, (300,), generator=random)
        true_m = 4 + 40 * torch.rand(300, generator=random)
        prior_m = scale[frame] / (1 / true_m - shift[frame])
        prior_m[:100] *= 10
        rays = Rays(torch.zeros(300, 3), torch.ones(300, 3), depth_m=prior_m)
        alignment.learn(frame, rays, torch.ones(300), seen(true_m))
        optimiser.step(OptimiserConfig(), step / steps)
    frame = torch.tensor([0, 1, 2]).repeat_interleave(50)
    true_m = torch.linspace(5, 40, 50).repeat(3)
    prior_m = scale[frame] / (1 / true_m - shift[frame])
    aligned_m = alignment.applied(frame, Rays(torch.zeros(150, 3), torch.ones(150, 3), depth_m=prior_m)).depth_m
    assert aligned_m is not None
    off = (aligned_m / true_m - 1).abs()
    assert off.max() < 0.1, "it was 0.67"
    assert off.mean() < 0.03
    other = alignment.applied(torch.tensor([3]), Rays(torch.zeros(1, 3), torch.ones(1, 3), depth_m=torch.tensor([9.0])))
    assert float(other.depth_m) == pytest.approx(9, rel=0.01), "a frame that does not train has the drive's scale"


def test_its_gradient_is_that_of_its_formula() -> None:
    random = torch.Generator().manual_seed(2)
    frame = torch.randint(0, 3, (60,), generator=random)
    prior_m, found_m, weight = (0.5 + torch.rand(3, 60, generator=random, dtype=torch.float64)).unbind()
    prior_m, found_m = 20 * prior_m, 20 * found_m
    alignment = Alignment(3, [0, 1, 2], "cpu")
    alignment.log_scale, alignment.shift = (0.1 * torch.randn(2, 3, generator=random, dtype=torch.float64)).unbind()
    rays = Rays(torch.zeros(60, 3), torch.ones(60, 3), depth_m=prior_m)
    alignment.learn(frame, rays, weight, seen(found_m))
    s, b = (tensor.clone().requires_grad_() for tensor in (alignment.log_scale, alignment.shift))
    inverse = torch.exp(s.median().detach() - s[frame]) / prior_m + SHIFT * b[frame]
    off = torch.log(found_m * inverse)
    each = torch.zeros(3, dtype=torch.float64).index_add(0, frame, weight * off**2 / 2 / (1 + (off / 0.2) ** 2))
    loss = (each / torch.zeros(3, dtype=torch.float64).index_add(0, frame, weight)).sum()
    loss = loss + PULL / 2 * ((s - s.median().detach()).square().sum() + b.square().sum())
    for tensor, expected in zip((alignment.log_scale, alignment.shift), torch.autograd.grad(loss, (s, b)), strict=True):
        torch.testing.assert_close(tensor.grad, expected)


def test_what_is_no_depth_stays_none() -> None:
    alignment = Alignment(1, [0], "cpu")
    bad_m = torch.tensor([0.0, -1.0, float("nan"), float("inf"), 5.0])
    rays = Rays(torch.zeros(5, 3), torch.ones(5, 3), depth_m=bad_m)
    frame = torch.zeros(5, dtype=torch.int64)
    assert alignment.applied(frame, rays).depth_m.tolist() == [0, 0, 0, 0, 5]  # type: ignore[union-attr]
    alignment.learn(frame, rays, torch.ones(5), seen(torch.full((5,), 6.0)))
    assert all(torch.isfinite(tensor.grad).all() for tensor in alignment.parameters().values())


def test_a_checkpoint_keeps_it_and_goes_on_to_the_same_bits(tmp_path: Path) -> None:
    scene, learn = corridor("sparse"), replace(config(24), align="learn")
    whole = fit(scene, learn, tmp_path / "whole")

    class Killed(Exception):
        pass

    def kill(status: Status) -> None:
        if status.step == 11:
            raise Killed

    with pytest.raises(Killed):
        fit(scene, learn, tmp_path / "parts", kill)
    parts = fit(scene, learn, tmp_path / "parts").parameters()
    assert whole.parameters()["alignment.log_scale"].abs().max() > 0
    for name, tensor in whole.parameters().items():
        assert torch.equal(tensor, parts[name]), name
    opened = checkpoint.open_model(tmp_path / "whole")
    assert torch.equal(opened.parameters()["alignment.shift"], parts["alignment.shift"])


def test_it_needs_a_prior_and_a_field_that_learns(street: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--align learn: expected auto where there is no prior"):
        begin(open_drive(street), None, fit=FitConfig(align="learn"), folder=tmp_path / "run")
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_scale_that_drifts_costs_next_to_nothing(tmp_path: Path) -> None:
    """20 % of drift along the frames; the scene's own depth is exact."""
    scene = corridor("sparse", count=40)
    drift = 1 + 0.2 * np.sin(np.arange(len(scene.ids)) / 5)
    wrong = replace(scene, depth_m=(scene.depth_m * drift[:, None, None]).astype(np.float32))  # type: ignore[operator]
    errors = {}
    for name, each, align in (("right", scene, "none"), ("wrong", wrong, "none"), ("learned", wrong, "learn")):
        model = fit(each, replace(config(150), align=align), tmp_path / name)
        view = model.render(scene.T_world_cam[scene.test[1]], scene.camera)
        truth_m = scene.depth_m[scene.test[1]]  # type: ignore[index]
        errors[name] = float(np.mean(np.abs(view.depth_m - truth_m)[truth_m > 0] / truth_m[truth_m > 0]))
    assert errors["learned"] < errors["wrong"]
