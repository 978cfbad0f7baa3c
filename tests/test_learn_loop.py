"""Training: it stops and goes on bit for bit, keeps the best, refuses a stranger's checkpoint."""

import json
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from torch import Tensor, nn

from cli.priors.train import StereoArguments, started_from
from priors.adapt.finetune import AdaptConfig
from priors.adapt.training_step import Batch
from priors.errors import DataError
from priors.learn.completion import CompletionConfig
from priors.learn.config import TrainConfig
from priors.learn.loop import train
from priors.learn.mono import MonoConfig
from priors.learn.sky_left_out import SkyLeftOut
from priors.learn.teacher_labels import TeacherConfig
from priors.types import Image

CONFIG = TrainConfig(steps=40, lr=1e-2, warm_up=5, validate_every=10)


class Line:
    """Learns y = 3x."""

    def __init__(self, stop_at: int | None = None, width: int = 4) -> None:
        torch.manual_seed(0)
        self.net: nn.Module = nn.Sequential(nn.Conv2d(1, width, 1), nn.BatchNorm2d(width), nn.Conv2d(width, 1, 1))
        self.stop_at, self.calls = stop_at, 0
        self.first: list[float] = []

    def batch(self, step: int, rng: np.random.Generator) -> Batch:
        x = torch.from_numpy(rng.random((2, 1, 8, 8), dtype=np.float32))
        return {"x": x}

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        if torch.is_grad_enabled():  # else the average is being measured
            self.calls += 1
            self.first.append(float(batch["x"][0, 0, 0, 0]))
            if self.calls == self.stop_at:
                signal.raise_signal(signal.SIGINT)
        error = (self.net(batch["x"]).float() - 3 * batch["x"]).square().mean()
        return error, {"error": error.detach()}

    def validate(self, net: nn.Module) -> dict[str, float]:
        x = torch.linspace(0, 1, 64).view(1, 1, 8, 8)
        return {"error": float((net(x) - 3 * x).detach().square().mean())}

    def pictures(self, net: nn.Module) -> dict[str, Image]:
        return {"line": np.zeros((4, 4, 3), np.uint8)}


def weights(folder: Path) -> dict[str, Tensor]:
    return load_file(folder / "last.safetensors")


def test_the_average_has_the_statistics_of_its_own_activations(tmp_path: Path) -> None:
    class Odd(Line):
        """Sees something absurd once."""

        def batch(self, step: int, rng: np.random.Generator) -> Batch:
            made = super().batch(step, rng)
            return {"x": 1e4 * made["x"]} if step == 35 else made

    train(Odd(), tmp_path, CONFIG)
    found = weights(tmp_path)
    weight, bias = found["average.0.weight"].flatten(), found["average.0.bias"]
    torch.testing.assert_close(found["average.1.running_mean"], 0.5 * weight + bias, atol=0.02, rtol=0.02)
    torch.testing.assert_close(found["average.1.running_var"], weight.square() / 12, atol=1e-3, rtol=0.1)


def test_a_run_that_was_stopped_goes_on_bit_for_bit(tmp_path: Path) -> None:
    train(Line(), tmp_path / "whole", CONFIG)
    first = Line(stop_at=17)
    train(first, tmp_path / "parts", CONFIG)
    assert json.loads((tmp_path / "parts" / "last.json").read_text())["step"] == 17
    train(Line(), tmp_path / "parts", CONFIG)
    whole, parts = weights(tmp_path / "whole"), weights(tmp_path / "parts")
    assert whole.keys() == parts.keys()
    for name, value in whole.items():
        assert torch.equal(value, parts[name]), name


def test_every_batch_is_another_one(tmp_path: Path) -> None:
    task = Line()
    train(task, tmp_path, CONFIG)
    assert len(set(task.first)) == 40


def test_training_learns_and_keeps_the_best(tmp_path: Path) -> None:
    last = train(Line(), tmp_path, TrainConfig(steps=300, lr=3e-2, warm_up=5, validate_every=50, weight_decay=0.0))
    assert last["error"] < 0.05
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    errors = [line["validation"]["error"] for line in lines if "validation" in line]
    assert errors[0] > 4 * min(errors)
    best = Line().net
    best.load_state_dict(load_file(tmp_path / "best.safetensors"))
    assert Line().validate(best.eval())["error"] == pytest.approx(min(errors), rel=1e-4)
    assert (tmp_path / "pictures" / "line.png").exists()


def test_a_finished_run_is_not_trained_further(tmp_path: Path) -> None:
    train(Line(), tmp_path, CONFIG)
    before = weights(tmp_path)
    again = Line()
    train(again, tmp_path, CONFIG)
    assert again.calls == 0
    assert all(torch.equal(value, before[name]) for name, value in weights(tmp_path).items())


def test_the_checkpoint_of_another_network_is_refused(tmp_path: Path) -> None:
    train(Line(), tmp_path, CONFIG)
    with pytest.raises(DataError, match="not a checkpoint of this network"):
        train(Line(width=8), tmp_path, CONFIG)


def test_a_step_that_is_not_finite_is_left_out(tmp_path: Path) -> None:
    class Broken(Line):
        def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
            loss, terms = super().loss(batch)
            return loss * (float("nan") if self.calls == 7 else 1.0), terms

    train(Broken(), tmp_path, CONFIG)
    assert all(value.isfinite().all() for value in weights(tmp_path).values())


@pytest.mark.parametrize(
    "make",
    [
        lambda: TrainConfig(lr=0),
        lambda: TrainConfig(minutes=float("inf")),
        lambda: TrainConfig(ema=1.0),
        lambda: TrainConfig(steps=0),
        lambda: TrainConfig(validate_every=0),
        lambda: TrainConfig(threads=0),
        lambda: TrainConfig(warm_up=-1),
        lambda: AdaptConfig(seconds=0),
        lambda: AdaptConfig(steps=0),
        lambda: AdaptConfig(batch=0),
        lambda: AdaptConfig(ema=-0.1),
        lambda: CompletionConfig(real_share=1.5),
        lambda: CompletionConfig(batch=0),
        lambda: MonoConfig(real_share=-1),
        lambda: MonoConfig(batch=0),
        lambda: TeacherConfig(Path("a"), Path("b"), Path("c"), Path("d"), every=0),
        lambda: SkyLeftOut(Path("runs"), Path("a"), taught_steps=0),
    ],
)
def test_settings_check_themselves(make: Callable[[], object]) -> None:
    with pytest.raises(DataError, match="expected") as caught:
        make()
    assert "\n" not in str(caught.value)


def test_a_wrong_setting_is_one_line_of_the_command(tmp_path: Path) -> None:
    command = [str(Path(sys.executable).parent / "priors"), "train", "mono", str(tmp_path / "run"), "--ema", "1.5"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode != 0
    (line,) = done.stderr.strip().splitlines()
    assert "--ema 1.5" in line and "expected" in line


def test_a_run_remembers_what_it_started_from(tmp_path: Path) -> None:
    """Going on without --start must not make the first stage learn alone again."""
    out = tmp_path / "run"
    assert started_from(StereoArguments(out)) is None
    assert started_from(StereoArguments(out, start=Path("weights/cfnet-s.safetensors"))) == "cfnet-s.safetensors"
    train(Line(), out, TrainConfig(steps=2), {"net": "line", "size": "s", "start": "cfnet-s.safetensors"})
    assert started_from(StereoArguments(out)) == "cfnet-s.safetensors"
