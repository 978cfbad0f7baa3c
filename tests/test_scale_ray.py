"""Builds on a Ray cluster: the local engine's maps, whatever dies; and what cannot be begun is told in a line."""

import errno
import json
import os
import pickle
import socket
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from factories import write_as_folder
from nerf_commands import nerf
from safetensors.torch import load_file

from cli.priors import PROGRAM
from nerf import blocks_on_ray, study_on_ray
from nerf.blocks import part, parts_of
from nerf.config import FitConfig
from nerf.run import OWNER, open_run
from nerf.study import FitRunner, RunSpec, Study
from priors import build, drives
from priors.cache import Prior
from priors.errors import DataError, UsageError
from priors.filters import Filters
from priors.methods.completion import Completion
from priors.owner.process import me
from priors.scale import ray_session, scoring
from priors.scale.crew import Builder, Stretch, plan_drive
from priors.scale.drive_list import DriveEntry
from priors.scale.here import build_here
from priors.scale.order import Order
from priors.scale.ray_session import Share, session, slots
from priors.scale.tally import Part, Tally
from priors.scale.tasks import Done
from priors.score import pair, score_pairs
from priors.selection import Selection
from priors.street.write import write_street
from priors.types import Method

pytestmark = [pytest.mark.cluster, pytest.mark.usefixtures("fleet_choices")]
FRAMES, DEADLY, BROKEN = 10, "000003", "000007"


@pytest.fixture(scope="module")
def cluster(fleet_choices: None) -> Iterator[Any]:
    """Two cores of this machine as a Ray cluster, for all tests of this file; its processes have our environment."""
    if os.environ.get("ROADPRIOR_CLUSTER") != "required":
        pytest.importorskip("ray")
    ray = ray_session.import_ray()
    given = {"log_to_driver": False, "logging_level": 40}
    ray.init("local", num_cpus=2, include_dashboard=False, object_store_memory=100 * 2**20, **given)
    yield ray
    ray.shutdown()


@pytest.fixture
def fleet(tmp_path: Path) -> list[Path]:
    """Two drives without files."""
    from priors.drives.counted import write_counted  # type: ignore[import-not-found]

    return [write_counted(tmp_path / name, FRAMES) for name in ("one", "two")]


def fragile(**settings: Any) -> Method:
    from priors.methods.fragile import Fragile  # type: ignore[import-not-found]

    method: Method = Fragile(**settings)
    return method


def order(drive: Path, method: Method, cache: Path, frames: str | None = None) -> Order:
    return Order(DriveEntry(drive, "counted", frames=frames), method, Filters(), cache, Selection(frames))


def maps(cache: Path) -> dict[str, bytes]:
    return {str(path.relative_to(cache)): path.read_bytes() for path in sorted(cache.glob("*/*/depth/*.png"))}


def test_a_cluster_makes_the_same_maps_and_outlives_what_kills_its_processes(
    cluster: Any, fleet: list[Path], tmp_path: Path
) -> None:
    """Frames that are there are not made again; a deadly one takes three processes and is reported, others go on."""
    from priors.scale.on_ray import build_on_ray

    method = fragile(deadly=DEADLY, broken=BROKEN)
    for drive in fleet:
        build.prepare(drives.open_drive(drive), method, folder=tmp_path / "local").run(
            build.Plan([index for index in range(FRAMES) if index not in (3, 7)])
        )
    before = order(fleet[0], method, tmp_path / "cache").prepare()
    before.run(before.plan(Selection("0:3")))
    tallies = [Tally(drive.name, str(drive)) for drive in fleet]
    orders = [order(drive, method, tmp_path / "cache") for drive in fleet]
    build_on_ray(orders, 1, lambda part: tallies[part.drive].add(part), Share(1))

    assert maps(tmp_path / "cache") == maps(tmp_path / "local")
    made = [tally.part for tally in tallies]
    assert [(each.cached, each.built, each.done) for each in made] == [(3, 5, 7), (0, 8, 10)]
    for each in made:
        assert sorted(each.failed) == [DEADLY, BROKEN]
        assert "3 processes died with it" in each.failed[DEADLY]
        assert "ZeroDivisionError: by what the image shows" in each.failed[BROKEN]
        lines = [
            json.loads(line)["id"] for line in (Path(each.folder) / "frames.jsonl").read_text("utf-8").splitlines()
        ]
        assert len(lines) == len(set(lines)) == 8, "a frame was computed twice"


def test_scores_of_a_cluster_are_those_of_one_machine(
    cluster: Any, street: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stretches are merged in the frames' order; a damaged map is left out with its reason."""
    monkeypatch.setattr(scoring, "STRETCH", 2)
    drive = drives.open_drive(write_as_folder(drives.open_drive(street), tmp_path / "street"))
    prior = build.prepare(drive, Completion(), folder=tmp_path / "cache").run().prior
    alone = score_pairs(pair(prior, drive)).result
    pairs = replace(pair(prior, drive), scorer=scoring.RayScorer(cluster, Share(1)))
    told: list[str] = []
    assert score_pairs(pairs, on_frame=told.append).result == alone and sorted(told) == prior.ids()
    prior.depth_path(prior.ids()[0]).write_bytes(b"no map")
    score_pairs(pairs)
    assert list(pairs.left_out) == [prior.ids()[0]]


def test_a_study_on_a_cluster_makes_every_run_once(
    street: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cells travel as plain values; what is done is found done; a run whose process dies is told."""

    def one_by_one(_: Any, function: Any, items: Any, share: Share) -> Iterator[Done[Any]]:
        cells = pickle.loads(pickle.dumps(list(items)))
        for number, item in reversed(list(enumerate(cells))):
            lost = item.spec.seed == 1
            yield Done(number, None if lost else function(item), "3 processes died with it" if lost else "")

    write_street(tmp_path / "street", 10, 7, (32, 96))
    drive = drives.open_drive(tmp_path / "street")
    monkeypatch.setattr(study_on_ray, "run_tasks", one_by_one)
    fit, grid = FitConfig(steps=1, rays=16, seconds=None, align="none"), Study(views=("dense",), seeds=(0, 1, 2))
    runner = FitRunner(drive, fit, device="cpu")

    def cell_of(spec: RunSpec, config: dict[str, Any]) -> study_on_ray.Cell:
        folder = tmp_path / "study" / spec.name
        return study_on_ray.Cell(spec, folder, config, "nerf fit", drive.describe(), fit, None, "cpu", ())

    for fresh in (True, False):
        engine: Any = (None, Share(1))
        made = study_on_ray.run_study_on_ray(grid, cell_of, runner.settings, engine)
        assert [outcome.spec.seed for outcome in made] == [0, 1, 2]
        assert [outcome.report is not None for outcome in made] == [True, False, True]
        assert made[0].fresh is fresh and made[1].error == "3 processes died with it"


def test_blocks_on_a_cluster_are_the_bits_of_one_process(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They go on where a run was left, and the claim of a process that died is taken over; no task is for what is done.

    A block that cannot be fitted is told in a line, and the others are fitted.
    """
    write_street(tmp_path / "street", 20, 7, (32, 96))
    words = ["fit", tmp_path / "street", "--blocks", 9, "--rays", 64, "--device", "cpu", "--threads", 1]
    far = ["--engine", "ray", "--cpus-per-worker", 1]

    def fitted(name: str, steps: int, *more: object) -> int:
        return nerf(*words, "--steps", steps, "--run", tmp_path / "runs" / name, *more)

    def weights(name: str) -> list[dict[str, torch.Tensor]]:
        return [load_file(each / "checkpoint.safetensors") for each in parts_of(tmp_path / "runs" / name)]

    assert fitted("here", 1) == 0 == fitted("there", 1)
    (part(tmp_path / "runs" / "there", 0) / OWNER).write_text(json.dumps({"token": "x", **me(2**22 - 1).record()}))
    assert fitted("here", 3) == 0 == fitted("there", 3, *far)
    here, there = weights("here"), weights("there")
    assert len(here) == len(there) >= 2
    for one, other in zip(here, there, strict=True):
        assert one.keys() == other.keys() and all(torch.equal(one[name], other[name]) for name in one)
    assert (tmp_path / "runs" / "there" / "metrics.json").exists()

    damaged = part(tmp_path / "runs" / "there", 1) / "checkpoint.safetensors"
    damaged.write_bytes(b"no checkpoint")
    monkeypatch.setattr(blocks_on_ray, "is_done", lambda folder, config, number: False)
    run = open_run(tmp_path / "runs" / "there")
    with pytest.raises(DataError, match=r"1 of \d+ blocks are not fitted, the first is block 1: .*damaged checkpoint"):
        blocks_on_ray.RayBlocks(cluster, Share(1))(run, "cpu", lambda status: None)


def test_what_a_process_does_needs_no_engine(fleet: list[Path], tmp_path: Path) -> None:
    """A stretch that is given twice, as after a kill, is computed once; a drive that is gone is told by its frames."""
    orders = [order(fleet[0], fragile(), tmp_path / "cache")]
    planned = list(plan_drive(0, orders[0], 4))
    assert isinstance(planned[0], Part) and (planned[0].todo, planned[0].cached) == (FRAMES, 0)
    stretches = [each for each in planned if isinstance(each, Stretch)]
    assert [each.indices for each in stretches] == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9]]
    builder = Builder(orders, 1, 1)
    parts = [builder(stretch) for stretch in [*stretches, stretches[0]]]
    assert [part.built for part in parts] == [4, 4, 2, 4] and not any(part.failed for part in parts)
    assert len(maps(tmp_path / "cache")) == FRAMES
    (fleet[0] / "counted.txt").unlink()
    lost = Builder(orders, 1, 1)(stretches[0])
    assert lost.done == len(lost.failed) == 4
    assert [part.error for part in plan_drive(0, orders[0], 4) if isinstance(part, Part)] != [""]


def test_what_was_built_before_the_disk_was_full_counts(
    fleet: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The drive's error is told with it, and the other drive is built."""
    write = Prior.write

    def full(prior: Prior, frame_id: str, *rest: Any) -> Any:
        if frame_id == BROKEN and prior.folder.parent.name == "one":
            raise OSError(errno.ENOSPC, "No space left on device", str(prior.folder))
        return write(prior, frame_id, *rest)

    monkeypatch.setattr(Prior, "write", full)
    tallies = [Tally(drive.name, str(drive)) for drive in fleet]
    orders = [order(drive, fragile(), tmp_path / "cache") for drive in fleet]
    build_here(orders, 1, lambda part: tallies[part.drive].add(part))
    one, two = (tally.part for tally in tallies)
    assert "No space left on device" in one.error and one.left > 0
    assert one.built == len(list(Path(one.folder).glob("depth/*.png"))) >= int(BROKEN)
    assert (two.built, two.error) == (FRAMES, "")


def test_a_command_builds_many_drives(street: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Here, one after the other: the missing one is told, the table has a row each, summary.json has all."""
    for name in ("one", "two"):
        write_as_folder(drives.open_drive(street)[:2], tmp_path / name)
    listed = tmp_path / "drives.txt"
    listed.write_text("two --frames 0:1\nnone\n")
    words = ["build", str(tmp_path / "one"), str(listed), "--method", "completion", "--completion.model", "classical"]
    for built in ((2, 1), (0, 0)):
        assert PROGRAM.run([*words, "--cache", str(tmp_path / "cache")]) == 1
        done = capsys.readouterr()
        assert f"{tmp_path / 'none'}: no such folder" in done.err
        summary = json.loads((tmp_path / "cache" / "summary.json").read_text("utf-8"))
        rows = [(row["name"], row["built"], row["cached"], bool(row["error"])) for row in summary["drives"]]
        assert rows == [
            ("one", built[0], 2 - built[0], False),
            ("two", built[1], 1 - built[1], False),
            ("none", 0, 0, True),
        ]


def test_without_ray_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(DataError, match=r"pip install 'roadprior\[cluster\]'"), session(None):
        pass


def test_no_cluster_at_the_address_is_one_line() -> None:
    """Where nothing listens Ray is not asked: it would wait for minutes."""

    def refuse(**_: Any) -> None:
        raise ConnectionError("could not find any running Ray instance\nmore lines")

    ray: Any = SimpleNamespace(init=refuse)
    with pytest.raises(DataError, match=r"^--address auto: no cluster there: `ray start --head` begins one$"):
        ray_session._connect(ray, "auto")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        nobody = f"127.0.0.1:{free.getsockname()[1]}"
    unasked: Any = SimpleNamespace(init=lambda **_: pytest.fail("Ray was asked"))
    for address in (nobody, f"ray://{nobody}"):
        with pytest.raises(DataError, match=r"no cluster there: .*[Rr]efused"):
            ray_session._connect(unasked, address)
    for address in ("here", "127.0.0.1", "127.0.0.1:x", ":6379"):
        with pytest.raises(UsageError, match="expected auto, HOST:PORT or ray://HOST:PORT"):
            ray_session._connect(unasked, address)


def test_a_share_that_no_node_has_is_refused() -> None:
    nodes = [{"Alive": True, "Resources": {"CPU": 8.0, "GPU": 1.0}}, {"Alive": False, "Resources": {"CPU": 99.0}}]
    ray: Any = SimpleNamespace(nodes=lambda: nodes)
    assert slots(ray, Share(3)) == 2 and slots(ray, Share(1, 0.5)) == 2
    with pytest.raises(DataError, match="no node has 9 cores"):
        slots(ray, Share(9))
