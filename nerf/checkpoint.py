"""Checkpoints: one safetensors file, written whole or not at all; a resumed run goes on bit for bit."""

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors import torch as tensors
from torch import Tensor

from nerf.model import Model, ModelConfig
from nerf.occupancy import Occupancy
from nerf.optimise import Optimiser
from nerf.space import Space
from priors.codecs import write_bytes
from priors.errors import DataError
from priors.records import restore

NAME = "checkpoint.safetensors"
FORMAT = "1"


@dataclass(frozen=True)
class Progress:
    """How far a run is."""

    step: int = 0
    elapsed_s: float = 0.0


def save(run: Path, model: Model, optimiser: Optimiser, progress: Progress) -> None:
    """Write the run's checkpoint; a full disk or a kill leaves the one before."""
    state = {f"model.{name}": tensor for name, tensor in model.parameters().items()}
    state |= {f"occupancy.{name}": tensor for name, tensor in model.occupancy.state().items()}
    state |= {f"optimiser.{name}": tensor for name, tensor in optimiser.state().items()}
    described = {"space": asdict(model.space), "config": asdict(model.config), "progress": asdict(progress)}
    metadata = {"format": FORMAT} | {name: json.dumps(value) for name, value in described.items()}
    whole = {name: tensor.detach().cpu().contiguous() for name, tensor in state.items()}
    write_bytes(run / NAME, tensors.save(whole, metadata))


def resume(run: Path, model: Model, optimiser: Optimiser) -> Progress:
    """Bring model and optimiser to the run's checkpoint; the beginning where there is none."""
    if not (run / NAME).exists():
        return Progress()
    state, metadata = _read(run)
    _fill(model, state, run)
    optimiser.load(_under("optimiser.", state))
    return restore(Progress, json.loads(metadata["progress"]))


def progress(run: Path) -> Progress:
    """Return how far a run's checkpoint is; the beginning where there is none."""
    return restore(Progress, json.loads(_read(run)[1]["progress"])) if (run / NAME).exists() else Progress()


def open_model(run: Path, device: torch.device | str = "cpu") -> Model:
    """Load a run's model to render it.

    Raises:
        DataError: there is no checkpoint, or it is damaged or of another format.
    """
    state, metadata = _read(run)
    config = restore(ModelConfig, json.loads(metadata["config"]))
    space = restore(Space, json.loads(metadata["space"]))
    resolution = state["occupancy.kept"].shape[-1]
    model = Model(config, space, Occupancy(space, resolution, device), device=device)
    _fill(model, state, run)
    return model


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


def _fill(model: Model, state: dict[str, Tensor], run: Path) -> None:
    """Copy tensors into the model."""
    for name, tensor in model.parameters().items():
        saved = state.get(f"model.{name}")
        if saved is None or saved.shape != tensor.shape:
            raise DataError(f"{run / NAME}: made with other settings ({name}): use another --run, or delete it")
        tensor.copy_(saved)
    model.occupancy.load(_under("occupancy.", state))


def _under(prefix: str, state: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): tensor for name, tensor in state.items() if name.startswith(prefix)}
