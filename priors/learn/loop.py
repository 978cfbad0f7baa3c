"""The training loop that every network shares: read it in one sitting.

OUT/last.safetensors    weights, their running average, the optimiser's moments; written every minute and when stopped
   /last.json           step, seconds spent, config
   /best.safetensors    the running average that validated best: what `priors train pack` takes
   /log.jsonl           a line every few steps, and one a validation
   /pictures/*.png      what the network sees now

A stopped run goes on where it was: the batches follow from the seed and the step alone.
"""

import copy
import json
import math
import signal
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Protocol

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from priors import codecs
from priors.adapt.batch import Batch
from priors.errors import DataError
from priors.learn.config import TrainConfig
from priors.nets import weights
from priors.nets.blocks import channels_last
from priors.types import Image

AHEAD = 3
"""Batches made in advance by the background thread."""
NORM_BATCHES = 40
"""Batches that the average's batch normalisations are measured on."""


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


@dataclass(frozen=True)
class Progress:
    """What a step tells whoever watches."""

    step: int
    done: float
    """Share of the run, in [0, 1]."""
    values: dict[str, float]


def train(
    task: Task,
    out: Path,
    config: TrainConfig,
    about: dict[str, str | None] | None = None,
    device: str = "cpu",
    on_step: Callable[[Progress], None] = lambda progress: None,
) -> dict[str, float]:
    """Train until the time or the steps are used up, or Ctrl-C; returns the last validation.

    Args:
        task: what is learned.
        out: the run's folder.
        config: how.
        about: what last.json says of the network: its name and size, and the weights that it started from.
        device: where.
        on_step: called every 20 steps.

    Raises DataError where the folder holds a run of another network, or the loss stops being finite.
    """
    if config.threads:
        torch.set_num_threads(config.threads)
    run = _Run(task, out, config, device)
    run.about = about or {}
    run.resume()
    with _Interrupt() as interrupt, ThreadPoolExecutor(max_workers=1) as pool:
        ahead: dict[int, Future[Batch]] = {}
        while run.progress() < 1 and not interrupt.asked:
            for step in range(run.step, run.step + AHEAD):
                if step not in ahead:
                    ahead[step] = pool.submit(task.batch, step, np.random.default_rng([config.seed, step]))
            values = run.advance(ahead.pop(run.step).result())
            if values:
                on_step(Progress(run.step, run.progress(), values))
            if run.step % config.validate_every == 0:
                run.validate()
            if time.monotonic() - run.saved > config.save_s:
                run.save()
        for future in ahead.values():
            future.cancel()
    if not interrupt.asked:
        run.validate()
    run.save()
    return run.last


def about_run(out: Path) -> dict[str, str | None]:
    """Return what a run's last.json says of its network; nothing where there is no run yet."""
    try:
        found: dict[str, str | None] = json.loads((out / "last.json").read_text())["about"]
    except (OSError, ValueError, KeyError):
        return {}
    return found


class _Run:
    """The state of a training run: what the checkpoint holds."""

    def __init__(self, task: Task, out: Path, config: TrainConfig, device: str) -> None:
        self.task, self.out, self.config = task, out, config
        self.device = torch.device(device)
        self.net = channels_last(task.net.to(self.device))
        self.net.train()
        self.average = copy.deepcopy(self.net).eval().requires_grad_(False)
        kernels = [p for p in self.net.parameters() if p.ndim > 1]
        others = [p for p in self.net.parameters() if p.ndim <= 1]
        groups: list[dict[str, Any]] = [{"params": kernels, "weight_decay": config.weight_decay}]
        groups.append({"params": others, "weight_decay": 0.0})
        self.optimiser = torch.optim.AdamW(groups, lr=config.lr, betas=(0.9, 0.98), fused=True)
        self.step, self.spent_s, self.best = 0, 0.0, math.inf
        self.last: dict[str, float] = {}
        self.about: dict[str, str | None] = {}
        self.started = self.saved = time.monotonic()

    def seconds(self) -> float:
        """Return the time spent in this run and those it goes on from."""
        return self.spent_s + time.monotonic() - self.started

    def progress(self) -> float:
        """Return the share of the run that is done."""
        if self.config.steps is not None:
            return self.step / max(1, self.config.steps)
        return self.seconds() / (60 * self.config.minutes)

    def advance(self, batch: Batch) -> dict[str, float]:
        """Take one step; returns what the log gets, now and then."""
        batch = {name: value.to(self.device) for name, value in batch.items()}
        self._set_rate()
        with torch.autocast(self.device.type, torch.bfloat16):
            loss, terms = self.task.loss(batch)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.net.parameters(), self.config.clip)
        if torch.isfinite(norm):  # a step that is not finite is left out, and seen in the log
            self.optimiser.step()
        self._follow()
        self.step += 1
        if self.step % 20:
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

    def _follow(self) -> None:
        """Move the running average; it starts as a plain mean so that early weights do not linger."""
        keep = min(self.config.ema, (self.step + 1) / (self.step + 10))
        with torch.no_grad():
            for ours, theirs in zip(self.average.parameters(), self.net.parameters(), strict=True):
                ours.lerp_(theirs, 1 - keep)

    def _measure_norms(self) -> None:
        """Measure the statistics of the average's batch normalisations on batches that pass through it.

        Averaging the network's statistics would not do (Izmailov et al., UAI 2018): averaged weights have activations
        of their own, and one odd batch would stay in an average for a thousand steps.
        """
        norms = [m for m in self.average.modules() if isinstance(m, nn.BatchNorm2d | nn.BatchNorm3d)]
        momenta = [norm.momentum for norm in norms]
        for norm in norms:
            norm.reset_running_stats()
            norm.momentum = None  # a plain mean
        self.average.train()
        self.task.net, kept = self.average, self.task.net
        try:
            with torch.no_grad(), torch.autocast(self.device.type, torch.bfloat16):
                for number in range(NORM_BATCHES if norms else 0):
                    batch = self.task.batch(self.step, np.random.default_rng([self.config.seed, number, NORM_BATCHES]))
                    self.task.loss({name: value.to(self.device) for name, value in batch.items()})
        finally:
            self.task.net = kept
            self.average.eval()
            for norm, momentum in zip(norms, momenta, strict=True):
                norm.momentum = momentum

    def validate(self) -> None:
        """Measure the average, draw what it sees, keep it if it is the best so far."""
        self._measure_norms()
        with torch.inference_mode():
            self.last = self.task.validate(self.average)
            for name, picture in self.task.pictures(self.average).items():
                codecs.write_image(self.out / "pictures" / f"{name}.png", picture)
        self._log({"step": self.step, "seconds": round(self.seconds(), 1), "validation": self.last})
        if self.last.get("error", math.inf) <= self.best:
            self.best = self.last.get("error", math.inf)
            _write(self.out / "best.safetensors", dict(self.average.state_dict()))

    def save(self) -> None:
        """Write the checkpoint: one file, so that a kill leaves the old or the new one; the json is for people."""
        tensors = {f"net.{k}": v for k, v in self.net.state_dict().items()}
        tensors.update({f"average.{k}": v for k, v in self.average.state_dict().items()})
        for index, state in self.optimiser.state_dict()["state"].items():
            tensors.update({f"adam.{index}.{name}": value for name, value in state.items()})
        state = {"step": self.step, "seconds": self.seconds(), "best": self.best, "last": self.last}
        _write(self.out / "last.safetensors", tensors, {"state": json.dumps(state)})
        record = {**state, "about": self.about, "config": asdict(self.config)}
        codecs.write_bytes(self.out / "last.json", json.dumps(record, indent=2).encode())
        self.saved = time.monotonic()

    def resume(self) -> None:
        """Go on from the folder's checkpoint, where there is one."""
        path = self.out / "last.safetensors"
        if not path.exists():
            return
        try:
            tensors, state = load_file(path), json.loads(_metadata(path)["state"])
            self.net.load_state_dict(weights.under(tensors, "net."))
            self.average.load_state_dict(weights.under(tensors, "average."))
        except (RuntimeError, OSError, ValueError, KeyError) as error:
            text = str(error).splitlines()[0]
            raise DataError(f"{path}: not a checkpoint of this network ({text}): choose another --out") from error
        moments: dict[int, dict[str, Tensor]] = {}
        for name, value in weights.under(tensors, "adam.").items():
            index, field = name.split(".", 1)
            moments.setdefault(int(index), {})[field] = value
        self.optimiser.load_state_dict({"state": moments, "param_groups": self.optimiser.state_dict()["param_groups"]})
        self.step, self.spent_s, self.best = state["step"], state["seconds"], state["best"]
        self.last = state["last"]

    def _log(self, line: dict[str, Any]) -> None:
        self.out.mkdir(parents=True, exist_ok=True)
        with (self.out / "log.jsonl").open("a") as file:
            file.write(json.dumps(line) + "\n")


def _metadata(path: Path) -> dict[str, str]:
    from safetensors import safe_open

    with safe_open(path, "pt") as file:
        return file.metadata() or {}


def _write(path: Path, tensors: dict[str, Tensor], metadata: dict[str, str] | None = None) -> None:
    plain = {name: value.detach().cpu().contiguous().clone() for name, value in tensors.items()}
    path.parent.mkdir(parents=True, exist_ok=True)
    codecs.write_atomically(path, lambda target: save_file(plain, target, metadata))


class _Interrupt:
    """Turns Ctrl-C and a polite kill into a wish to stop after the step in hand."""

    def __init__(self) -> None:
        self.asked = False
        self._before: dict[int, Any] = {}

    def __enter__(self) -> "_Interrupt":
        for number in (signal.SIGINT, signal.SIGTERM):
            try:
                self._before[number] = signal.signal(number, self._ask)
            except ValueError:  # not the main thread: whoever runs us there handles signals
                break
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)

    def _ask(self, number: int, frame: FrameType | None) -> None:
        self.asked = True
