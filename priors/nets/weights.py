"""Trained weights: safetensors files (no pickle) whose header says which network they are of."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from eval.files import write_bytes
from priors.errors import DataError, unreadable

FOLDER = Path(__file__).resolve().parents[1] / "weights"
"""What ships with the package: <net>-<size>.safetensors, each with a card (.md) beside it."""


@dataclass(frozen=True, slots=True)
class Weights:
    """A file's content."""

    path: Path
    about: dict[str, Any]
    """The header: net, size, and whatever training left there (calibration, steps, data, ...)."""
    tensors: dict[str, Tensor]


def find(net: str, size: str, file: Path | None = None) -> Path:
    """Return the user's file, or the one that ships for a network and size; DataError where it is missing."""
    path = FOLDER / f"{net}-{size}.safetensors" if file is None else file
    if path.is_file():
        return path
    if file is not None:
        raise DataError(f"{path}: no such file of weights")
    there = sorted(file.stem for file in FOLDER.glob("*.safetensors"))
    raise DataError(
        f"no weights for {net} in size {size} ({path.name}); there are {', '.join(there) or 'none'}: "
        "choose another size, train it (`priors train`), or name a file"
    )


def digest(path: Path) -> str:
    """Return the SHA-256 of a file of weights: part of a cache's key."""
    try:
        stat = path.stat()
    except OSError as error:
        raise unreadable(path, error) from error
    return _digest(path, stat.st_mtime_ns, stat.st_size)


def load(path: Path) -> Weights:
    """Read a file of weights; DataError where it is missing or damaged."""
    try:
        with safe_open(path, framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
            return Weights(path, _decode(file.metadata() or {}), tensors)
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file of weights") from error
    except (SafetensorError, OSError) as error:
        raise DataError(f"{path}: damaged, or no safetensors file ({error}): download or train it again") from error


def read_about(path: Path) -> dict[str, Any]:
    """Read the header only."""
    try:
        with safe_open(path, framework="pt") as file:
            return _decode(file.metadata() or {})
    except (SafetensorError, OSError) as error:
        raise DataError(f"{path}: damaged, or no safetensors file ({error}): download or train it again") from error


def fill(net: nn.Module, weights: Weights, name: str, size: str) -> None:
    """Put weights into a network, as float32; DataError where they are another network's or size's."""
    for what, wanted in (("net", name), ("size", size)):
        held = weights.about.get(what)
        if held is not None and held != wanted:
            raise DataError(f"{weights.path}: weights of {what} {held}, asked for {wanted}: name the one or the other")
    wanted_shapes = {key: value.shape for key, value in net.state_dict().items() if not _counts(key)}
    shapes = {key: value.shape for key, value in weights.tensors.items() if not _counts(key)}
    if shapes != wanted_shapes:
        differ = sorted(
            key for key in shapes.keys() | wanted_shapes.keys() if shapes.get(key) != wanted_shapes.get(key)
        )
        raise DataError(
            f"{weights.path}: not the weights of this version's {name}-{size}: "
            f"{len(differ)} tensors differ, first {differ[0]}"
        )
    net.load_state_dict(
        {key: value.float() for key, value in weights.tensors.items() if not _counts(key)}, strict=False
    )


def take(net: nn.Module, path: Path) -> int:
    """Put those of a file's weights into a network whose names and shapes fit; returns how many did.

    Raises DataError where none does.
    """
    ours = net.state_dict()
    fitting = {k: v.float() for k, v in load(path).tensors.items() if k in ours and ours[k].shape == v.shape}
    if not fitting:
        raise DataError(f"{path}: no tensor fits this network: start from weights of its kind, or from none")
    net.load_state_dict(fitting, strict=False)
    return len(fitting)


def under(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return the tensors whose names begin with a prefix, without it."""
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def write(path: Path, net: nn.Module, about: dict[str, Any], dtype: torch.dtype = torch.float16) -> None:
    """Write a network's weights, atomically: kernels as dtype, everything else (norms, biases) as float32."""
    tensors = {
        key: value.detach().cpu().to(dtype if value.dim() > 1 else torch.float32).contiguous()
        for key, value in net.state_dict().items()
        if not _counts(key)
    }
    write_bytes(path, save(tensors, _encode(about)))


def rewrite_about(path: Path, **changes: Any) -> None:
    """Change entries of a file's header and nothing else."""
    weights = load(path)
    write_bytes(path, save(weights.tensors, _encode({**weights.about, **changes})))


@lru_cache(maxsize=16)
def _digest(path: Path, _changed_ns: int, _bytes: int) -> str:
    return sha256(path.read_bytes()).hexdigest()


def _counts(key: str) -> bool:
    """Tell whether an entry only counts batches: inference does without."""
    return key.endswith("num_batches_tracked")


def _encode(about: dict[str, Any]) -> dict[str, str]:
    """Turn values into the texts that a header holds: JSON, except plain words."""
    return {
        key: value if isinstance(value, str) else json.dumps(value, allow_nan=False) for key, value in about.items()
    }


def _decode(texts: dict[str, str]) -> dict[str, Any]:
    about: dict[str, Any] = {}
    for key, text in texts.items():
        try:
            about[key] = json.loads(text)
        except ValueError:
            about[key] = text
    return about
