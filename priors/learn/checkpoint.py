"""Checkpoints of training runs: written, read, and packed into a file of weights for the methods."""

import json
from pathlib import Path
from typing import Any

from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from eval.files import write_atomically, write_bytes
from priors.errors import DataError
from priors.nets import runtime, weights

HEADROOM = {"cfnet": 1.25, "pcwnet": 1.25}
"""How far beyond a scene's largest disparity stereo networks search: of 27 pairs of KITTI 2015 the disparities near the
end of the range are wrong by 1.9 px without, by 1.6 px with this, and by 1.55 px with 192 px."""
LAST, BEST, RECORD = "last.safetensors", "best.safetensors", "last.json"


def write(path: Path, tensors: dict[str, Tensor], state: dict[str, Any] | None = None) -> None:
    """Write tensors and a run's state to one file, atomically."""
    plain = {name: value.detach().cpu().contiguous().clone() for name, value in tensors.items()}
    metadata = None if state is None else {"state": json.dumps(state)}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, lambda target: save_file(plain, target, metadata))


def read(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read tensors and a run's state; DataError where the file is damaged or holds no state."""
    try:
        with safe_open(path, "pt") as file:
            state: dict[str, Any] = json.loads((file.metadata() or {})["state"])
        return load_file(path), state
    except (RuntimeError, OSError, ValueError, KeyError) as error:
        raise not_ours(path, error) from error


def not_ours(path: Path, error: Exception) -> DataError:
    """Return the error of a checkpoint that cannot be gone on from."""
    reason = str(error).splitlines()[0]
    return DataError(f"{path}: not a checkpoint of this network ({reason}): train into another folder")


def write_record(out: Path, record: dict[str, Any]) -> None:
    """Write what people want to know of a run."""
    write_bytes(out / RECORD, json.dumps(record, indent=2).encode())


def about_run(out: Path) -> dict[str, str | None]:
    """Return what a run's record says of its network; nothing where there is no run yet."""
    try:
        about: dict[str, str | None] = json.loads((out / RECORD).read_text(encoding="utf-8"))["about"]
    except (OSError, ValueError, KeyError):
        return {}
    return about


def seconds_of(out: Path) -> float:
    """Return how long a run has trained so far; 0 where there is none yet."""
    try:
        return float(json.loads((out / RECORD).read_text(encoding="utf-8"))["seconds"])
    except (OSError, ValueError, KeyError):
        return 0.0


def pack_run(run: Path, out: Path) -> None:
    """Write the best weights of a run to a file in half precision; DataError where the run has none yet.

    Its header says what it is and what made it.
    """
    try:
        record = json.loads((run / RECORD).read_text(encoding="utf-8"))
        tensors = load_file(run / BEST)
    except (OSError, ValueError) as error:
        raise DataError(f"{run}: no validated weights in it: train until the first validation, or longer") from error
    net = runtime.create(record["about"]["net"], record["about"]["size"])
    net.load_state_dict(tensors)
    learned = {"steps": record["step"], "hours": round(record["seconds"] / 3600, 2), "seed": record["config"]["seed"]}
    searched = {"headroom": HEADROOM[name]} if (name := record["about"]["net"]) in HEADROOM else {}
    weights.write(out, net, {**record["about"], **learned, **searched, "validation": record["last"]})
