"""A node of a Ray cluster that dies in the middle of a build: the others make its frames, each once."""

import os
from pathlib import Path
from typing import Any

import pytest

from priors.scale.drive_list import DriveEntry
from priors.scale.here import build_here
from priors.scale.order import Order

pytestmark = [pytest.mark.cluster, pytest.mark.usefixtures("fleet_choices")]
FRAMES = 24


def test_frames_of_a_killed_node_are_made_elsewhere_and_none_is_made_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The maps are the local engine's bytes; tests/bench/killed_node.py measures the same on street drives."""
    if os.environ.get("ROADPRIOR_CLUSTER") != "required":
        pytest.importorskip("ray")
    monkeypatch.syspath_prepend(Path(__file__).parent / "bench")
    import killed_node  # type: ignore[import-not-found]

    from priors.drives.counted import write_counted  # type: ignore[import-not-found]
    from priors.methods.fragile import Fragile  # type: ignore[import-not-found]

    drives = [write_counted(tmp_path / "drives" / name, FRAMES) for name in ("one", "two")]

    def orders(cache: str) -> list[Order]:
        return [Order(DriveEntry(drive, "counted"), Fragile(0.05), cache=tmp_path / cache) for drive in drives]

    def here(note: Any) -> Any:
        return killed_node.timed(lambda: build_here(orders("local"), 1, note))

    killer = killed_node.Killer(FRAMES // 2, tmp_path / "killed")
    local = killed_node.build("local", tmp_path / "local", here)
    killed_node.import_ray()
    killed = killed_node.build(
        "killed", tmp_path / "killed", lambda note: killed_node.on_two_nodes(orders("killed"), note, killer)
    )
    assert killer.in_hand is not None, "the node was not killed"
    assert len(local.maps) == 2 * FRAMES and killed.maps == local.maps
    assert killed.twice == 0 and not killed.failed
