"""From a training run to a file of weights: half precision, and a header that says what it is and what made it."""

import json
from pathlib import Path

from safetensors.torch import load_file

from priors.errors import DataError
from priors.nets import runtime, weights


def pack_run(run: Path, out: Path) -> None:
    """Write the best weights of a run to a file; DataError where the run has none yet."""
    try:
        record = json.loads((run / "last.json").read_text())
        tensors = load_file(run / "best.safetensors")
    except (OSError, ValueError) as error:
        raise DataError(f"{run}: no validated weights in it: train until the first validation, or longer") from error
    net = runtime.create(record["about"]["net"], record["about"]["size"])
    net.load_state_dict(tensors)
    learned = {"steps": record["step"], "hours": round(record["seconds"] / 3600, 2), "seed": record["config"]["seed"]}
    weights.write(out, net, {**record["about"], **learned, "validation": record["last"]})
