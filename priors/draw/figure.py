"""Figures: how all plots look, and the files they become.

PNG, SVG or PDF by the name's ending. The same plot gives the same bytes: no file holds a date. Text stays text in SVG
and PDF: it can be searched and edited. Nothing here needs a screen, and matplotlib is imported when something is drawn.
"""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from eval.files import write_bytes
from priors.errors import DataError

if TYPE_CHECKING:  # matplotlib takes half a second to import
    from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
"""Okabe and Ito's colours (2008), which colour-blind people can tell apart; without yellow, too faint on white."""
INK, FAINT, GRID = "#1a1a1a", "#555555", "#dddddd"
DPI = 160
_STYLE: dict[str, Any] = {
    "font.size": 9,
    "figure.constrained_layout.w_pad": 0.09,
    "figure.constrained_layout.h_pad": 0.07,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "legend.frameon": True,
    "legend.framealpha": 0.85,
    "legend.edgecolor": "none",
    "savefig.dpi": DPI,
    "text.parse_math": False,  # a drive's or a run's name may hold dollar signs
    "svg.fonttype": "none",
    "svg.hashsalt": "roadprior",
    "pdf.fonttype": 42,  # TrueType: what publishers ask for
}
_METADATA: dict[str, dict[str, None]] = {
    ".png": {"Software": None},
    ".svg": dict.fromkeys(("Creator", "Date", "Format", "Type")),
    ".pdf": dict.fromkeys(("Creator", "Producer", "CreationDate")),
}


def check_name(path: Path) -> None:
    """Refuse a plot's file before any work; DataError where its name ends in none of .png, .svg, .pdf."""
    if path.suffix.lower() not in _METADATA:
        raise DataError(f"{path}: expected a plot's name that ends in {', '.join(_METADATA)}")


@contextmanager
def styled() -> Iterator[None]:
    """Let what is drawn inside look like all our plots, whatever the user's matplotlibrc says."""
    import matplotlib.style

    with matplotlib.style.context(["default", _STYLE]):
        yield


def save(figure: "Figure", path: Path) -> None:
    """Write a figure, atomically; DataError where the name ends in none of .png, .svg, .pdf."""
    check_name(path)
    write_bytes(path, encode(figure, path.suffix.lower()))


def encode(figure: "Figure", suffix: str) -> bytes:
    """Return the bytes of a figure's file; suffix is .png, .svg or .pdf."""
    buffer = io.BytesIO()
    with styled():
        figure.savefig(buffer, format=suffix[1:], metadata=_METADATA[suffix])
    return buffer.getvalue()
