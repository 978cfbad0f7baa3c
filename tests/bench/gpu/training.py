"""Training on the GPU: each network from the weights that ship, on a pack of crops; or one command of the user's.

Runs lie in a folder of their own, so that the next call goes on. What comes back are weights for `--stereo.weights` and
its siblings, and each run's log.
"""

import json
import os
import shlex
import shutil
import subprocess
import time
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from priors.errors import DataError
from priors.learn import checkpoint
from priors.learn.completion import CompletionConfig, CompletionTask
from priors.learn.config import TrainConfig
from priors.learn.crop_pack import RECORD, CropPack
from priors.learn.loop import train
from priors.learn.mono import MonoConfig, MonoTask
from priors.learn.stereo import StereoTask
from priors.learn.stereo_data import packed_mixture, packed_validation
from priors.learn.training_run import Task
from priors.machine import threads
from priors.nets import runtime, weights
from tests.bench.gpu.parts import note

ENDING_S = 20.0
"""What a network needs besides training: reading its crops, the last validation, writing."""
LEAST_S = 2.0


@dataclass(frozen=True)
class Network:
    """A network that is trained, from where, how fast."""

    name: str
    size: str
    lr: float
    batch: int
    """Crops in a step on a GPU; on a CPU there is one."""

    @property
    def start(self) -> Path:
        """Weights that ship."""
        return weights.find(self.name, self.size)

    def task(self, crops: Path, batch: int) -> Task:
        """Make what it learns."""
        if self.name == "mffnet":
            return CompletionTask(CompletionConfig(crops=crops, batch=batch, size=self.size))
        if self.name == "bts":
            return MonoTask(MonoConfig(crops=crops, batch=batch, size=self.size, imagenet=False))
        pack = CropPack(crops)
        net = runtime.create(self.name, self.size)
        return StereoTask(net, packed_mixture(pack), packed_validation(pack), batch, schedule=(0, 0))


NETWORKS = (
    Network("cfnet", "s", 2e-4, 16),
    Network("mffnet", "s", 3e-4, 16),
    Network("bts", "m", 2e-4, 16),
)


def run(options: Namespace) -> None:
    """Train and note what comes of it; raise SystemExit where a user's command fails."""
    if options.train:
        return _run_command(options)
    if not (options.crops / RECORD).exists():
        return note(left_out=f"{options.crops}: no crops here: make gpu-crops where the data is")
    chosen = [network for network in NETWORKS if network.name in options.networks]
    for number, network in enumerate(chosen):
        left_s = (options.deadline - time.time()) / (len(chosen) - number) - ENDING_S
        if left_s < LEAST_S:
            note(**{f"left out, {network.name}": f"{left_s:.0f} s were left"})
            continue
        _train(network, left_s, options)
    return None


def _train(network: Network, left_s: float, options: Namespace) -> None:
    """Train one network, going on where an earlier call stopped; its best weights and its log go to OUT."""
    name, on_gpu = f"{network.name}-{network.size}", options.device == "cuda"
    folder, batch = options.runs / name, network.batch if on_gpu else 1
    torch.backends.cudnn.benchmark = True  # crops are all of one size
    torch.manual_seed(0)
    task = network.task(options.crops, batch)
    before_s = checkpoint.seconds_of(folder)
    if not before_s:
        weights.take(task.net, network.start)
    whole_s = before_s + left_s if options.train_s is None else min(options.train_s, before_s + left_s)
    config = TrainConfig(
        minutes=whole_s / 60,
        lr=network.lr,
        warm_up=50,
        validate_every=500,
        save_s=20,
        workers=threads.available() if on_gpu else 1,
    )
    about = {"net": network.name, "size": network.size, "start": network.start.name}
    note(**{name: {"crops a step": batch}})
    train(task, folder, config, about, options.device)
    shutil.copy(folder / "log.jsonl", options.out / f"{name}.jsonl")
    note(**{name: figures(folder, batch)})
    try:
        checkpoint.pack_run(folder, options.out / f"{name}.safetensors")
    except DataError as error:  # stopped before its first validation ended
        note(**{f"{name}, no weights": str(error)})


def figures(folder: Path, batch: int) -> dict[str, Any]:
    """Return a run's steps, crops a second, loss, and the errors of its start and of its best weights.

    All that was validated, by source, stands in the log.
    """
    lines = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    steps = [line for line in lines if "loss" in line]
    validations = [line["validation"] for line in lines if "validation" in line]
    found: dict[str, Any] = {"crops a step": batch}
    if len(steps) > 1:
        first, last = steps[0], steps[-1]
        speed = batch * (last["step"] - first["step"]) / max(last["seconds"] - first["seconds"], 1e-6)
        found |= {"steps": last["step"], "crops/s": round(speed, 1), "loss": round(last["loss"], 4)}
    if validations:
        errors = [values["error"] for values in validations]
        found |= {"error, start": round(errors[0], 4), "error, best": round(min(errors), 4)}
    return found


def _run_command(options: Namespace) -> None:
    """Run a user's command with PACK, OUT and DEVICE in its environment; raise SystemExit where it fails.

    What it prints is kept; a line that holds a JSON object is kept as figures; what it writes to OUT comes back.
    """
    command = shlex.split(options.train)
    note(command=shlex.join(command))
    places = {"PACK": str(options.pack), "OUT": str(options.out), "DEVICE": options.device}
    code = subprocess.run(command, env=os.environ | places, check=False).returncode
    if code:
        raise SystemExit(f"the training command ends with code {code}")
