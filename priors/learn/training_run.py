"""A training run: the network, its optimiser and its running average, step by step; what a checkpoint holds."""

import json
import math
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from priors import codecs
from priors.adapt.training_step import Batch, WeightAverage, descend, to_device
from priors.errors import DataError
from priors.learn import checkpoint
from priors.learn.config import TrainConfig
from priors.nets import weights
from priors.nets.blocks import channels_last
from priors.types import Image

AVERAGE_DELAY = 9
"""Of the running average: see training_step.WeightAverage."""
NORM_BATCHES = 40
"""Batches that the average's batch normalisations are measured on."""
LOG_EVERY = 20
"""Steps from one line of the log to the next."""


class Task(Protocol):
    """What a network learns, from what, and how well it does."""

    net: nn.Module

    def batch(self, step: int, rng: np.random.Generator) -> Batch:
        """Make a batch; called in a background thread, and decided by its arguments alone."""
        ...

    def loss(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the loss and what else the log should hold; called under bf16 autocast where that is fast."""
        ...

    def validate(self, net: nn.Module) -> dict[str, float]:
        """Measure a network in eval mode on what was never trained on; "error" decides which one is best."""
        ...

    def pictures(self, net: nn.Module) -> dict[str, Image]:
        """Draw what a network in eval mode sees."""
        ...


class TrainingRun:
    """The state of a training."""

    def __init__(self, task: Task, out: Path, config: TrainConfig, about: dict[str, str | None], device: str) -> None:
        """Start a run: see loop.train for the arguments."""
        self.task, self.out, self.config, self.about = task, out, config, about
        self.device = torch.device(device)
        self.net = channels_last(task.net.to(self.device))
        self.net.train()
        self.average = WeightAverage(self.net, config.ema, AVERAGE_DELAY)
        self.optimiser = make_optimiser(self.net, config)
        self.step, self.spent_s, self.best = 0, 0.0, math.inf
        self.validation: dict[str, float] = {}
        self.started = self.saved = time.monotonic()

    def seconds(self) -> float:
        """Return the time spent in this run and those it goes on from."""
        return self.spent_s + time.monotonic() - self.started

    def progress(self) -> float:
        """Return the share of the run that is done."""
        if self.config.steps is not None:
            return self.step / self.config.steps
        return self.seconds() / (60 * self.config.minutes)

    def advance(self, batch: Batch) -> dict[str, float]:
        """Take one step; returns what the log gets, now and then."""
        batch = to_device(batch, self.device)
        self._set_rate()
        with torch.autocast(self.device.type, torch.bfloat16):
            loss, terms = self.task.loss(batch)
        # A step that is not finite is left out, and seen in the log.
        norm = descend(loss, self.optimiser, self.net.parameters(), self.config.clip)
        self.step += 1
        self.average.update(self.net, self.step)
        if self.step % LOG_EVERY:
            return {}
        values = {"loss": float(loss.detach()), "norm": float(norm)}
        values.update({name: float(value) for name, value in terms.items()})
        if not all(math.isfinite(float(p.detach().sum())) for p in self.net.parameters()):
            raise DataError(
                f"training: weights are not finite after step {self.step}: lower --lr, go on from {self.out}"
            )
        self._log({"step": self.step, "seconds": round(self.seconds(), 1), **values})
        return values

    def _set_rate(self) -> None:
        rise = min(1.0, (self.step + 1) / max(1, self.config.warm_up))
        fall = 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * min(1.0, self.progress())))
        for group in self.optimiser.param_groups:
            group["lr"] = self.config.lr * rise * fall

    def _measure_norms(self) -> None:
        """Measure the statistics of the average's batch normalisations on batches that pass through it.

        Averaging the network's statistics would not do (Izmailov et al., UAI 2018): averaged weights have activations
        of their own, and one odd batch would stay in an average for a thousand steps.
        """
        average = self.average.net
        norms = [m for m in average.modules() if isinstance(m, nn.BatchNorm2d | nn.BatchNorm3d)]
        momenta = [norm.momentum for norm in norms]
        for norm in norms:
            norm.reset_running_stats()
            norm.momentum = None  # a plain mean
        average.train()
        self.task.net, trained = average, self.task.net
        try:
            with torch.no_grad(), torch.autocast(self.device.type, torch.bfloat16):
                for batch in self._norm_batches() if norms else ():
                    self.task.loss(to_device(batch, self.device))
        finally:
            self.task.net = trained
            average.eval()
            for norm, momentum in zip(norms, momenta, strict=True):
                norm.momentum = momentum

    def _norm_batches(self) -> Iterator[Batch]:
        """Yield the batches to measure norms on; as many are made at a time as there are workers."""

        def make(number: int) -> Batch:
            return self.task.batch(self.step, np.random.default_rng([self.config.seed, number, NORM_BATCHES]))

        numbers, workers = range(NORM_BATCHES), self.config.workers
        with ThreadPoolExecutor(workers) as pool:
            for first in numbers[::workers]:
                yield from pool.map(make, numbers[first : first + workers])

    def validate(self) -> None:
        """Measure the average, draw what it sees, keep it if it is the best so far.

        Weights that a run starts from are measured as they are.
        """
        if self.step:
            self._measure_norms()
        average = self.average.net
        with torch.inference_mode():
            self.validation = self.task.validate(average)
            for name, picture in self.task.pictures(average).items():
                codecs.write_image(self.out / "pictures" / f"{name}.png", picture)
        self._log({"step": self.step, "seconds": round(self.seconds(), 1), "validation": self.validation})
        error = self.validation.get("error", math.inf)
        if error <= self.best:
            self.best = error
            checkpoint.write(self.out / checkpoint.BEST, dict(average.state_dict()))

    def save(self) -> None:
        """Write the checkpoint: one file, so that a kill leaves the old or the new one; the json is for people."""
        tensors = {f"net.{k}": v for k, v in self.net.state_dict().items()}
        tensors.update({f"average.{k}": v for k, v in self.average.net.state_dict().items()})
        for index, moments in self.optimiser.state_dict()["state"].items():
            tensors.update({f"adam.{index}.{name}": value for name, value in moments.items()})
        state = {"step": self.step, "seconds": self.seconds(), "best": self.best, "last": self.validation}
        checkpoint.write(self.out / checkpoint.LAST, tensors, state)
        checkpoint.write_record(self.out, {**state, "about": self.about, "config": asdict(self.config)})
        self.saved = time.monotonic()

    def resume(self) -> None:
        """Go on from the folder's checkpoint, where there is one; DataError where it is of another network."""
        path = self.out / checkpoint.LAST
        if not path.exists():
            return
        tensors, state = checkpoint.read(path)
        try:
            self.net.load_state_dict(weights.under(tensors, "net."))
            self.average.net.load_state_dict(weights.under(tensors, "average."))
        except RuntimeError as error:
            raise checkpoint.not_ours(path, error) from error
        moments: dict[int, dict[str, Tensor]] = {}
        for name, value in weights.under(tensors, "adam.").items():
            index, field = name.split(".", 1)
            moments.setdefault(int(index), {})[field] = value
        self.optimiser.load_state_dict({"state": moments, "param_groups": self.optimiser.state_dict()["param_groups"]})
        self.step, self.spent_s, self.best = state["step"], state["seconds"], state["best"]
        self.validation = state["last"]

    def _log(self, line: dict[str, Any]) -> None:
        self.out.mkdir(parents=True, exist_ok=True)
        with (self.out / "log.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")


def make_optimiser(net: nn.Module, config: TrainConfig) -> torch.optim.Optimizer:
    """Make AdamW; weights of convolutions decay, norms and biases do not."""
    kernels = [p for p in net.parameters() if p.ndim > 1]
    others = [p for p in net.parameters() if p.ndim <= 1]
    groups: list[dict[str, Any]] = [{"params": kernels, "weight_decay": config.weight_decay}]
    groups.append({"params": others, "weight_decay": 0.0})
    return torch.optim.AdamW(groups, lr=config.lr, betas=(0.9, 0.98), fused=True)
