"""Checkpoints: one safetensors file, written whole or not at all; a resumed run goes on bit for bit."""

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors import torch as tensors
from torch import Tensor

from eval.files import write_bytes
from nerf import blocks, fields
from nerf.blended import BlendedModel
from nerf.blocks import parts_of
from nerf.config import FitConfig, ModelConfig
from nerf.model import GoesOn, Model
from nerf.scene import Scene
from priors import origin
from priors.errors import DataError
from priors.origin import Offset
from priors.records import restore

NAME = "checkpoint.safetensors"
FORMAT = "1"
_OURS = ("format", "config", "progress", "origin_m")
"""What the metadata hold besides the model's own record."""


@dataclass(frozen=True)
class Spent:
    """How much of its budget a run has spent."""

    step: int = 0
    elapsed_s: float = 0.0


def save(run: Path, model: Model, spent: Spent, origin_m: Offset = origin.NONE) -> None:
    """Write the run's checkpoint; a full disk or a kill leaves the one before.

    `origin_m` is the scene's; earlier checkpoints and those of drives near zero have none.
    """
    described = {"config": asdict(model.config), "progress": asdict(spent)} | model.record()
    described |= {} if origin_m == origin.NONE else {"origin_m": origin_m}
    metadata = {"format": FORMAT} | {name: json.dumps(value) for name, value in described.items()}
    whole = {name: tensor.detach().cpu().contiguous() for name, tensor in model.state().items()}
    write_bytes(run / NAME, tensors.save(whole, metadata))


def begin(run: Path, scene: Scene, config: FitConfig, device: str) -> Model:
    """Make the model of a run: of its checkpoint's record where there is one, else a new one.

    Raises:
        DataError: there is no such family, or the checkpoint is damaged.
    """
    family = fields.family(config.model.family)
    if not (run / NAME).exists() or not isinstance(family, GoesOn):
        return family.start(scene, config, device)
    metadata = _metadata(run)
    try:
        if json.loads(metadata["config"])["family"] != config.model.family:
            return family.start(scene, config, device)  # another family's: it is refused when it is loaded
        return family.go_on(scene, config, _record(metadata), device)
    except (ValueError, KeyError, TypeError) as error:
        raise _damaged(run / NAME, error) from error


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
    """Return how much a run's checkpoints have spent, those of its blocks together; nothing where there is none."""
    each = [restore(Spent, json.loads(_metadata(part)["progress"])) for part in _begun(run)]
    return Spent(sum(one.step for one in each), sum(one.elapsed_s for one in each))


def has_begun(run: Path) -> bool:
    """Tell whether a run has a checkpoint, or one of its blocks has."""
    return bool(_begun(run))


def _begun(run: Path) -> list[Path]:
    """List the folders of a run's checkpoints."""
    return [part for part in parts_of(run) if (part / NAME).exists()]


def origin_of(run: Path) -> Offset | None:
    """Return the origin of the scene that a run's checkpoint was trained on; None where there is no checkpoint."""
    begun = _begun(run)
    if not begun:
        return None
    x, y, z = json.loads(_metadata(begun[0]).get("origin_m", "[0, 0, 0]"))
    return float(x), float(y), float(z)


def open_model(run: Path, device: torch.device | str = "cpu") -> Model:
    """Load a run's model to render it.

    Raises:
        DataError: there is no checkpoint, or it is damaged, of another format, or of a family that is not here.
    """
    if (run / blocks.NAME).exists():
        parts = parts_of(run)
        return BlendedModel(blocks.load(run), lambda number: open_model(parts[number], device))
    state, metadata = _read(run)
    try:
        config = restore(ModelConfig, json.loads(metadata["config"]))
        return fields.family(config.family).open(config, _record(metadata), state, str(device))
    except (ValueError, KeyError, TypeError) as error:
        raise _damaged(run / NAME, error) from error


def digest(run: Path) -> str:
    """Return a hash of the run's checkpoint: tells one field from another."""
    parts = parts_of(run)
    hashes = [hashlib.sha256(_path(part).read_bytes()).hexdigest() for part in parts]
    return (hashes[0] if parts == [run] else hashlib.sha256("".join(hashes).encode()).hexdigest())[:16]


def _record(metadata: dict[str, str]) -> dict[str, Any]:
    """Return the model's own record."""
    return {name: json.loads(text) for name, text in metadata.items() if name not in _OURS}


def _path(run: Path) -> Path:
    path = run / NAME
    if not path.exists():
        raise DataError(f"{path}: no checkpoint: train first (`nerf fit DATA --run {run}`)")
    return path


def _read(run: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    metadata, path = _metadata(run), _path(run)
    try:
        return tensors.load_file(path), metadata
    except (SafetensorError, OSError) as error:
        raise _damaged(path, error) from error


def _metadata(run: Path) -> dict[str, str]:
    """Read what stands before the tensors."""
    path = _path(run)
    try:
        with safe_open(path, "pt") as file:
            metadata: dict[str, str] = file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise _damaged(path, error) from error
    if metadata.get("format") != FORMAT:
        raise DataError(f"{path}: checkpoint format {metadata.get('format')}, expected {FORMAT}: train again")
    return metadata


def _damaged(path: Path, error: Exception) -> DataError:
    return DataError(f"{path}: damaged checkpoint ({error}): delete it and train again")
