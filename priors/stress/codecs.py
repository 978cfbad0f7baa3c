"""Rows of the table: depth and confidence files, written and read back."""

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from priors import codecs
from priors.stress.inputs import Given
from priors.stress.precision import Floats
from priors.stress.routine import NO_BFLOAT, NO_POSES, Case, Outputs, Routine

SIZE = (12, 20)
MOST = 65535


def depth_png(encoding: str) -> Callable[[Given], Case]:
    """Write and read a depth PNG; what its codes cannot hold is no value, and counted."""
    scale = codecs.PNG_SCALE[encoding]

    def case(given: Given) -> Case:
        depth_m = given.values(0.1, 60, given.size(*SIZE))
        ours = given.precision.array(depth_m)

        def found() -> Outputs:
            data, too_large = codecs.encode_depth_png(ours, encoding)
            return {"depth": codecs.decode_depth_png(data, Path("a.png"), encoding), "too large": too_large}

        def wanted() -> Outputs:
            known = np.isfinite(depth_m) & (depth_m > 0)
            codes = np.array([round(value * scale) for value in np.where(known, depth_m, 0).flat], object)
            held = np.array([code if code <= MOST else 0 for code in codes], np.float64)
            return {"depth": (held / scale).reshape(depth_m.shape), "too large": sum(code > MOST for code in codes)}

        return Case(found, wanted)

    return case


def float_files(given: Given) -> Case:
    """Write and read float32 maps; what is no depth is 0."""
    depth_m = given.values(0.1, 60, given.size(*SIZE))
    ours = given.precision.array(depth_m)

    def found() -> Outputs:
        with tempfile.TemporaryDirectory() as folder:
            names = [Path(folder) / name for name in ("a.npy", "a.npz", "a.pfm")]
            np.save(names[0], ours)
            np.savez(names[1], depth=ours)
            codecs.write_pfm(names[2], ours)
            return {name.suffix: codecs.read_float_map(name) for name in names}

    answer: Floats = np.where(np.isfinite(depth_m) & (depth_m > 0), depth_m, 0)
    return Case(found, lambda: dict.fromkeys((".npy", ".npz", ".pfm"), answer))


def confidence_png(given: Given) -> Case:
    """Write and read a confidence, to half a code; what is not in [0, 1] is cut, NaN is 0."""
    confidence = given.values(0.01, 1, given.size(*SIZE))
    ours = given.precision.array(confidence)

    def found() -> Outputs:
        data = codecs.encode_confidence_png(ours)
        return {"confidence": codecs.decode_confidence_png(data, Path("a.png"))}

    def wanted() -> Outputs:
        return {"confidence": np.clip(np.where(np.isnan(confidence), 0, confidence), 0, 1)}

    return Case(found, wanted, scale={"confidence": 1.0})


ROUTINES = (
    Routine("kitti depth PNG", "priors/codecs.py", depth_png("kitti"), NO_POSES, NO_BFLOAT),
    Routine("mm depth PNG", "priors/codecs.py", depth_png("mm"), NO_POSES, NO_BFLOAT),
    Routine("npy, npz and pfm", "priors/codecs.py", float_files, NO_POSES, NO_BFLOAT),
    Routine("confidence PNG", "priors/codecs.py", confidence_png, NO_POSES, NO_BFLOAT),
)
