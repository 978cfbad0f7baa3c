"""A field's step on every kind of CPU that this machine can stand in for: one row a kind, each in its own process.

    python tests/bench/bench_kinds.py [--samples 65536] [--rounds 5]

Runs bench_field.py under each mode of ROADPRIOR_CPU (priors/machine/cpu.py). A kind that is not this machine's has its
instructions, but this machine's caches and clock; amx_emulated is left out, since its speed says nothing. PSNR of each
kind: `ROADPRIOR_CPU=... nerf study`, see docs/benchmarks.md.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from priors.machine import cpu


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=65536)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    print("| CPU mode | M samples/s | of the twin | networks, of a large product | back |\n|---|---:|---:|---:|---:|")
    for mode in cpu.supported()[:-1]:
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "figures.json"
            asked = ["--samples", str(options.samples), "--rounds", str(options.rounds), "--json", str(file)]
            command = [sys.executable, str(Path(__file__).with_name("bench_field.py")), *asked]
            environment = {**os.environ, cpu.VARIABLE: mode}
            subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
            found = json.loads(file.read_text())
        own = "" if mode == cpu.supported()[0] else " (held down)"
        shares = f"{found['networks']:.0%} | {found['networks_back']:.0%}"
        print(f"| {mode}{own} | {found['samples_s'] / 1e6:.2f} | {found['ratio']:.1f} x | {shares} |", flush=True)


if __name__ == "__main__":
    main()
