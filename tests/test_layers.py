"""The rooms of docs/architecture.md: a file imports from its own room and from those that stand before it in ROOMS."""

import ast
import re
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROOMS = [
    "eval",
    "priors/errors",
    "priors/lazy",
    "priors/extensions",
    "priors/records",
    "priors/owner",
    "priors/types",
    "priors/text",
    "priors/frame_ids",
    "priors/poses",
    "priors/selection",
    "priors/drive_around",
    "priors/held_back",
    "priors/codecs",
    "priors/machine",
    "priors/kernels",
    "priors/motion",
    "priors/geometry",
    "priors/origin",
    "priors/sky",
    "priors/error_model",
    "priors/recalibration",
    "priors/fusion",
    "priors/draw",
    "priors/cache",
    "priors/keys",
    "priors/refined_poses",
    "priors/drives",
    "priors/resized",
    "priors/places",
    "priors/sequences",
    "priors/pairs",
    "priors/egomotion",
    "priors/extrinsics",
    "priors/filters",
    "priors/nets",
    "priors/adapt",
    "priors/build",
    "priors/methods",
    "priors/check",
    "priors/imported",
    "priors/naming",
    "priors/flicker",
    "priors/score",
    "priors/reliability",
    "priors/report",
    "priors/view",
    "priors/export",
    "priors/bench",
    "priors/plan",
    "priors/scale",
    "priors/street",
    "priors/learn",
    "priors/stress",
    "nerf/types",
    "nerf/gaussians/types",
    "nerf/harmonics",
    "nerf/twin",
    "nerf/kernels",
    "nerf",
    "nerf/stress",
    "cli",
]
"""A room is a file, or a folder with all that is in it."""
LARGEST = 400
FILES = sorted(
    path.relative_to(ROOT) for top in ("eval", "priors", "nerf", "cli") for path in (ROOT / top).rglob("*.py")
)


def room(path: Path) -> int | None:
    """Return a file's place in the list, by the longest name that fits; None for a file that is in no room."""
    names = [str(path.with_suffix("")), *(str(parent) for parent in path.parents)]
    return next((ROOMS.index(name) for name in names if name in ROOMS), None)


def imports(path: Path) -> Iterator[Path]:
    """Give the files of ours that a file imports, at its top or in a function."""
    for node in ast.walk(ast.parse((ROOT / path).read_text())):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import: write it in full"
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        for name in names:
            yield from find(name)


def find(name: str) -> list[Path]:
    """Return the file that a dotted name means: a module, or the one that holds the name."""
    parts = name.split(".")
    for end in (len(parts), len(parts) - 1):
        base = Path(*parts[:end]) if end else Path("-")
        for path in (base.with_suffix(".py"), base / "__init__.py"):
            if path in FILES:
                return [path]
    return []


def test_imports_go_down() -> None:
    lost = [str(path) for path in FILES if room(path) is None and path.name != "__init__.py"]
    assert not lost, f"in no room: {lost}"
    up = [
        f"{path} ({ROOMS[own]}) imports {other} ({ROOMS[above]})"
        for path in FILES
        if (own := room(path)) is not None
        for other in imports(path)
        if (above := room(other)) is not None and above > own
    ]
    assert not up, "\n".join(["imports that go up:", *up])


def test_no_files_import_each_other() -> None:
    graph = {path: {other for other in imports(path) if other != path} for path in FILES}
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        circle = " -> ".join(map(str, error.args[1]))
        raise AssertionError(f"files that import each other: {circle}") from None


def test_files_can_be_read() -> None:
    """One noun a file; and `import eval` would hide the builtin, and take any eval.py that is first on the path."""
    long = [f"{path}: {n} lines" for path in FILES if (n := len((ROOT / path).read_text().splitlines())) > LARGEST]
    plain = [
        f"{path}: import eval: write `from eval.x import y`"
        for path in FILES
        for node in ast.walk(ast.parse((ROOT / path).read_text()))
        if isinstance(node, ast.Import) and any(alias.name == "eval" and not alias.asname for alias in node.names)
    ]
    assert not long + plain, "\n".join(long + plain)


def test_the_page_lists_the_rooms() -> None:
    """docs/architecture.md has a sentence for each room, in the order of ROOMS."""
    page = (ROOT / "docs" / "architecture.md").read_text()
    assert re.findall(r"^\| `([\w/]+)` \|", page, re.MULTILINE) == ROOMS
