"""A cache in an object store: moto's S3 server on the loopback, through fsspec and s3fs."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from factories import write_as_folder

from cli.priors import PROGRAM
from priors import build, cache
from priors.cache.store import is_store, mirror, store_of
from priors.drives import open_drive
from priors.errors import DataError
from priors.methods.completion import Completion
from priors.types import Drive

pytestmark = pytest.mark.cluster
BUCKET = "roads"


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    """A server with one bucket; its address."""
    if os.environ.get("ROADPRIOR_CLUSTER") != "required":
        pytest.importorskip("moto.server")
        pytest.importorskip("s3fs")
    from moto.server import ThreadedMotoServer

    running = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    running.start()
    host, port = running.get_host_and_port()
    yield f"http://{host}:{port}"
    running.stop()


@pytest.fixture
def bucket(server: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache in the store, as a command is given it."""
    import s3fs

    for name, value in {
        "AWS_ENDPOINT_URL": server,
        "AWS_ACCESS_KEY_ID": "mine",
        "AWS_SECRET_ACCESS_KEY": "mine",
        "AWS_DEFAULT_REGION": "us-east-1",
    }.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "here")
    s3fs.S3FileSystem.clear_instance_cache()
    fs = s3fs.S3FileSystem(use_listings_cache=False)
    if not fs.exists(BUCKET):
        fs.mkdir(BUCKET)
    return Path(f"s3://{BUCKET}/{tmp_path.name}")


@pytest.fixture
def drive(street: Path, tmp_path: Path) -> Drive:
    write_as_folder(open_drive(street)[:3], tmp_path / "drive")
    return open_drive(tmp_path / "drive")


def objects(bucket: Path) -> list[str]:
    import s3fs

    fs = s3fs.S3FileSystem(use_listings_cache=False)
    return sorted(name.partition("/")[2].partition("/")[2] for name in fs.find(bucket.as_posix().replace("s3:/", "")))


def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Be another machine, which has no mirror yet."""
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "there")


def test_a_build_fills_a_store_and_another_machine_goes_on(
    bucket: Path, drive: Drive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Maps are the bytes of a cache on a disk; none stays in the mirror; what is done is not done again."""
    on_disk = build.prepare(drive, Completion(), folder=tmp_path / "disk").run().prior
    first = build.prepare(drive, Completion(), folder=bucket)
    first.run(build.Plan([0, 1]))
    assert not list(first.prior.folder.glob("*/*.png"))
    elsewhere(tmp_path, monkeypatch)
    second = build.prepare(drive, Completion(), folder=bucket)
    assert second.plan().todo == [2]
    report = second.run()
    assert [line["id"] for line in report.built] == [drive.ids[2]]

    elsewhere(tmp_path / "again", monkeypatch)
    (found,) = cache.find(bucket)
    assert found.ids() == on_disk.ids() and found.name == on_disk.name
    for kind in ("depth", "confidence"):
        for id_ in found.ids() if (on_disk.folder / kind).is_dir() else []:
            assert found.path(kind, id_).read_bytes() == on_disk.path(kind, id_).read_bytes()
    assert sorted(found.lines()) == found.ids() and all(found.is_recorded(id_) for id_ in found.ids())


def test_depth_comes_last(bucket: Path, drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    """A build that is killed between two objects leaves a frame that is not done, and its map is made whole later."""
    job = build.prepare(drive, Completion(), folder=bucket)
    job.make_folder()
    store = job.prior.store
    assert store is not None
    put, done = store._put, []

    def dies(name: str, data: bytes) -> None:
        if name.endswith(".png") and "/depth/" in name:
            raise OSError(28, "the store is full", name)
        put(name, data)
        done.append(name)

    monkeypatch.setattr(store, "_put", dies)
    with pytest.raises(OSError, match="the store is full"):
        job.run(build.Plan([0]))
    assert any("/journal/" in name for name in done)
    assert not [name for name in objects(bucket) if "/depth/" in name]
    again = build.prepare(drive, Completion(), folder=bucket)
    assert again.plan().todo == [0, 1, 2]


def test_commands_take_a_store(bucket: Path, drive: Drive, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place, there = str(tmp_path / "drive"), f"s3://{BUCKET}/{tmp_path.name}"
    words = ["build", place, place + "/../drive", "--method", "completion", "--cache", there]
    assert PROGRAM.run(words) == 0, capsys.readouterr().err
    assert PROGRAM.run(["eval", there]) == 0, capsys.readouterr().err
    names = objects(bucket)
    assert "summary.json" in names
    for part in ("manifest.json", "metrics.json", "depth/"):
        assert any(part in name for name in names), part
    assert "AbsRel" in capsys.readouterr().out


def test_a_store_that_is_not_there_is_one_line(
    bucket: Path, drive: Drive, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code = PROGRAM.run(["eval", "s3://no-such-bucket/cache"])
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert code == 1 and len(errors) == 1 and "s3://no-such-bucket/cache" in errors[0]
    with pytest.raises(DataError, match="nowhere://x/y"):
        build.prepare(drive, Completion(), folder=Path("nowhere://x/y"))


def test_what_is_a_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert is_store(Path("s3://bucket/cache")) and is_store(Path("gs://b/c/d"))
    assert not is_store(Path("cache")) and not is_store(tmp_path) and not is_store(Path("a:b"))
    monkeypatch.chdir(tmp_path)
    Path("s3:/here").mkdir(parents=True)
    assert not is_store(Path("s3:/here")), "a folder of that name"
    assert mirror(tmp_path) == tmp_path and store_of(tmp_path) is None
