"""Checkpoints: one safetensors file, written whole or not at all; a resumed run goes on bit for bit."""

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors import torch as tensors
from torch import Tensor

from eval.files import write_bytes
from nerf import fields
from nerf.config import ModelConfig
from nerf.model import Model
from priors.errors import DataError
from priors.records import restore

NAME = "checkpoint.safetensors"
FORMAT = "1"
_OURS = ("format", "config", "progress")
"""What the metadata hold besides the model's own record."""


@dataclass(frozen=True)
class Spent:
    """How much of its budget a run has spent."""

    step: int = 0
    elapsed_s: float = 0.0


def save(run: Path, model: Model, spent: Spent) -> None:
    """Write the run's checkpoint; a full disk or a kill leaves the one before."""
    described = {"config": asdict(model.config), "progress": asdict(spent)} | model.record()
    metadata = {"format": FORMAT} | {name: json.dumps(value) for name, value in described.items()}
    whole = {name: tensor.detach().cpu().contiguous() for name, tensor in model.state().items()}
    write_bytes(run / NAME, tensors.save(whole, metadata))


def resume(run: Path, model: Model) -> Spent:
    """Bring a model to the run's checkpoint; nothing is spent where there is none.

    Raises:
        DataError: it is damaged, or of a model of other settings.
    """
    if not (run / NAME).exists():
        return Spent()
    state, metadata = _read(run)
    try:
        model.load(state)
    except ValueError as error:
        raise DataError(f"{run / NAME}: made with other settings ({error}): use another --run, or delete it") from error
    return restore(Spent, json.loads(metadata["progress"]))


def spent(run: Path) -> Spent:
    """Return how much a run's checkpoint has spent; nothing where there is none."""
    return restore(Spent, json.loads(_read(run)[1]["progress"])) if (run / NAME).exists() else Spent()


def open_model(run: Path, device: torch.device | str = "cpu") -> Model:
    """Load a run's model to render it.

    Raises:
        DataError: there is no checkpoint, or it is damaged, of another format, or of a family that is not here.
    """
    state, metadata = _read(run)
    try:
        config = restore(ModelConfig, json.loads(metadata["config"]))
        record = {name: json.loads(text) for name, text in metadata.items() if name not in _OURS}
        return fields.family(config.family).open(config, record, state, str(device))
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(f"{run / NAME}: damaged checkpoint ({error}): delete it and train again") from error


def digest(run: Path) -> str:
    """Return a hash of the run's checkpoint: tells one field from another."""
    return hashlib.sha256(_path(run).read_bytes()).hexdigest()[:16]


def _path(run: Path) -> Path:
    path = run / NAME
    if not path.exists():
        raise DataError(f"{path}: no checkpoint: train first (`nerf fit DATA --run {run}`)")
    return path


def _read(run: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    path = _path(run)
    try:
        with safe_open(path, "pt") as file:
            metadata = file.metadata() or {}
        state = tensors.load_file(path)
    except (SafetensorError, OSError) as error:
        raise DataError(f"{path}: damaged checkpoint ({error}): delete it and train again") from error
    if metadata.get("format") != FORMAT:
        raise DataError(f"{path}: checkpoint format {metadata.get('format')}, expected {FORMAT}: train again")
    return state, metadata
