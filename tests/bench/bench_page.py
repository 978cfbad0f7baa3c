"""Put what `priors bench` has measured into docs/benchmarks.md: python tests/bench/bench_page.py cache/DRIVE/bench

The table between the page's two marks, and the plot, are replaced.
"""

import argparse
from pathlib import Path

from eval import typeset
from eval.files import write_bytes
from priors.bench.results import Bench
from priors.bench.table import lay_out, scatter

DOCS = Path(__file__).resolve().parents[2] / "docs"
BEGIN, END = "<!-- priors bench -->", "<!-- end -->"


def main() -> None:
    """Rewrite the page's block and the plot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bench", type=Path, help="folder with a bench.json")
    parser.add_argument("--page", type=Path, default=DOCS / "benchmarks.md")
    options = parser.parse_args()
    bench = Bench.load(options.bench)
    before, _, rest = options.page.read_text(encoding="utf-8").partition(BEGIN)
    after = rest.partition(END)[2]
    block = f"{BEGIN}\n\n{typeset.markdown(lay_out(bench))}\n{END}"
    write_bytes(options.page, f"{before}{block}{after}".encode())
    drawn = scatter(bench)
    if drawn is not None:
        drawn.write(options.page.parent / "images/priors_error_time.png")


if __name__ == "__main__":
    main()
