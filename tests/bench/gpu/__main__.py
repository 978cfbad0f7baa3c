"""Everything that a borrowed GPU is asked, in one script with a budget per part.

python tests/bench/gpu --make-pack                      where the data is: put what the GPU needs into a folder
python tests/bench/gpu --pack gpu-pack --out OUT        on the machine with the GPU: measure
python tests/bench/gpu --device cpu --budget 90         a rehearsal without a GPU
"""

import argparse
import os
import sys
import types
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]


def pin() -> None:
    """Let our folders come first: a machine may have packages called `tests` or `nerf` of its own."""
    own = Path(__file__).resolve().parent
    sys.path[:] = [str(ROOT), *(path for path in sys.path if Path(path).resolve() != own)]
    tests = types.ModuleType("tests")
    tests.__path__ = [str(ROOT / "tests")]
    sys.modules["tests"] = tests


def flags() -> argparse.Namespace:
    from tests.bench.gpu.parts import NETWORKS, PARTS

    parser = argparse.ArgumentParser(prog="gpu", description=__doc__.splitlines()[0])
    parser.add_argument("--pack", type=Path, default=Path("gpu-pack"), help="folder that travels to the other machine")
    parser.add_argument("--make-pack", action="store_true", help="make that folder, then stop")
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data" / "kitti_raw_397x120")
    out = Path(os.environ.get("OUT", "gpu-out"))
    parser.add_argument("--out", type=Path, default=out, help="where the few files go that come back")
    parser.add_argument("--device", choices=["cuda", "cpu"], default="cuda")
    whole = sum(part.seconds for part in PARTS)
    parser.add_argument("--budget", type=float, help=f"seconds of all parts together; {whole} unless parts are chosen")
    parser.add_argument("--parts", nargs="+", choices=[part.name for part in PARTS], help="only these, in this order")
    parser.add_argument("--crops", type=Path, default=Path("gpu-crops"), help="what `train` learns from")
    parser.add_argument("--runs", type=Path, default=Path("gpu-runs"), help="where trainings go on from")
    parser.add_argument("--networks", nargs="+", choices=NETWORKS, default=[*NETWORKS], help="what `train` trains")
    parser.add_argument("--train-s", type=float, help="seconds each, all calls together; default: what the budget has")
    parser.add_argument("--train", help="a command that the part `train` runs instead")
    parser.add_argument("--part", help=argparse.SUPPRESS)  # in the process of one part
    parser.add_argument("--deadline", type=float, help=argparse.SUPPRESS)
    parser.add_argument("--scale", type=float, default=1.0, help=argparse.SUPPRESS)
    return parser.parse_args()


def main() -> int:
    """Pack, run all parts, or be the process of one part; returns the exit code."""
    pin()
    options = flags()
    if options.part:
        from tests.bench.gpu.parts import run_here

        run_here(options)
        return 0
    if options.make_pack:
        from tests.bench.gpu.pack import make_pack

        return make_pack(options.data, options.pack)
    from tests.bench.gpu.runner import run

    return run(options)


if __name__ == "__main__":
    sys.exit(main())
