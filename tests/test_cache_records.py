"""Records of a cache: checksums, marks of damage, many writers, folders that another tool or version wrote."""

import json
import threading
from pathlib import Path

import numpy as np
import pytest
from test_cache import manifest, some_depth

from priors import cache, codecs
from priors.cache.journal import Entry, Journal
from priors.cache.prior import DamagedError
from priors.errors import DataError
from priors.types import Depth


@pytest.fixture
def prior(tmp_path: Path) -> cache.Prior:
    made = cache.create(tmp_path / "drive" / "plane-0123456789", manifest())
    for id_ in ("0", "1"):
        made.write(id_, some_depth(), seconds=0.1)
    return made


def flip(path: Path) -> bytes:
    """Change a byte in the middle of a file: its size and its end stay."""
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    return bytes(data)


@pytest.mark.parametrize("part", ["depth", "confidence"])
def test_a_changed_byte_is_found_by_who_reads_and_mended_by_who_writes(prior: cache.Prior, part: str) -> None:
    flip(prior.path(part, "0"))
    assert prior.has("0"), "nothing was read yet"
    with pytest.raises(DamagedError, match=rf"{part}/0\.png: damaged: .*priors build"):
        prior.read("0")
    for reader in (prior, cache.load(prior.folder)):
        assert not reader.has("0") and reader.has("1")
        assert f"{part}/0.png" in str(reader.why_not_done("0"))
    prior.write("0", some_depth(), seconds=0.2)
    assert prior.has("0") and prior.read("0").density > 0
    assert prior.figures("seconds") == [0.2, 0.1]


def test_another_map_in_the_place_of_ours_is_damage_too(prior: cache.Prior) -> None:
    codecs.write_depth_png(prior.depth_path("0"), np.ones((4, 6), np.float32))
    assert not prior.has("0"), "its size tells"
    with pytest.raises(DamagedError):
        prior.read("0")


def test_damage_is_told_once(prior: cache.Prior) -> None:
    flip(prior.depth_path("0"))
    for _ in range(3):
        with pytest.raises(DamagedError):
            prior.read("0")
    assert (prior.folder / "frames.jsonl").read_text().count('"damaged"') == 1


def test_a_map_that_was_put_back_is_read(prior: cache.Prior) -> None:
    whole = prior.depth_path("0").read_bytes()
    flip(prior.depth_path("0"))
    with pytest.raises(DamagedError):
        prior.read("0")
    prior.depth_path("0").write_bytes(whole)
    assert prior.read("0").density > 0


def test_a_cache_that_cannot_be_written_is_read(prior: cache.Prior, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(journal: Journal, line: object) -> None:
        raise PermissionError(13, "Permission denied", str(journal.path))

    monkeypatch.setattr(Journal, "append", refuse)
    flip(prior.depth_path("0"))
    with pytest.raises(DamagedError, match="damaged"):
        prior.read("0")
    assert prior.read("1").density > 0


@pytest.mark.parametrize("name", ["depth", "confidence"])
def test_without_records_files_are_as_good(prior: cache.Prior, name: str) -> None:
    """As format 1, and as another tool writes it; what cannot be decoded is marked all the same."""
    (prior.folder / "frames.jsonl").unlink()
    found = cache.load(prior.folder)
    assert found.has("0") and found.read("0").confidence is not None and not found.is_recorded("0")
    path = found.path(name, "0")
    path.write_bytes(path.read_bytes()[:40] + path.read_bytes()[-12:])
    assert found.has("0"), "it ends as it should"
    with pytest.raises(DamagedError):
        found.read("0")
    assert not found.has("0")


def test_a_map_of_another_size_than_the_manifest_says_is_damaged(tmp_path: Path) -> None:
    made = cache.create(tmp_path / "plane-0", {**manifest(), "camera": {"size": [4, 7]}})
    made.write("0", some_depth(), seconds=0.1)
    with pytest.raises(DamagedError, match=r"\(4, 6\) and \(4, 7\)"):
        made.read("0")


def test_the_second_confidence_is_kept_read_and_cut(prior: cache.Prior) -> None:
    depth = some_depth()
    half = np.where(depth.valid, np.float32(0.25), np.float32(0))
    prior.write("0", Depth(depth.depth_m, depth.confidence, half), seconds=0.1)
    read = prior.read("0")
    assert read.consistency is not None and prior.read("1").consistency is None
    np.testing.assert_allclose(read.consistency[1, :5], 0.25, atol=1e-4)
    kept = read.keep(read.depth_m > 50)
    assert kept.consistency is not None and np.count_nonzero(kept.consistency) == np.count_nonzero(kept.depth_m)
    prior.write("0", some_depth(), seconds=0.1)
    assert prior.read("0").consistency is None, "of the earlier map"


def test_a_second_confidence_that_another_tool_made_is_read(prior: cache.Prior) -> None:
    codecs.write_confidence_png(prior.path("consistency", "0"), np.full((4, 6), 0.5, np.float32))
    assert prior.has("0") and prior.read("0").consistency is not None


def test_a_line_after_one_that_was_cut_off_is_not_lost(prior: cache.Prior) -> None:
    with (prior.folder / "frames.jsonl").open("a") as file:
        file.write('{"id": "7", "seco')
    prior.write("2", some_depth(), seconds=0.3)
    assert sorted(cache.load(prior.folder).lines()) == ["0", "1", "2"]


def test_a_full_disk_leaves_a_frame_as_not_done(prior: cache.Prior, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(journal: Journal, line: object) -> None:
        raise OSError(28, "No space left on device", str(journal.path))

    with monkeypatch.context() as patched:
        patched.setattr(Journal, "append", full)
        with pytest.raises(OSError, match="No space"):
            prior.write("2", some_depth(), seconds=0.1)
    assert not prior.has("2") and prior.ids() == ["0", "1"]
    assert not list(prior.folder.rglob(".*"))


def test_a_half_written_line_is_taken_back_on_a_full_disk(prior: cache.Prior, full_disk: object) -> None:
    path = prior.folder / "frames.jsonl"
    before = path.read_bytes()
    with full_disk(len(before) + 20), pytest.raises(OSError, match="File too large"):  # type: ignore[operator]
        prior.journal.append({"id": "3", "seconds": 0.1, "density": 0.5})
    assert path.read_bytes() == before


def test_many_writers_lose_no_line(tmp_path: Path) -> None:
    def write(writer: int) -> None:
        journal = Journal(tmp_path / "frames.jsonl")
        for number in range(30):
            journal.append({"id": f"{writer}-{number}", "made_of": {"image": {"file": "x" * 999}}})

    threads = [threading.Thread(target=write, args=(writer,)) for writer in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(Journal(tmp_path / "frames.jsonl").entries()) == 120


def test_a_journal_is_read_on_and_from_its_start_where_it_was_replaced(tmp_path: Path) -> None:
    journal, other = (Journal(tmp_path / "frames.jsonl") for _ in range(2))
    assert journal.entry("0") == Entry()
    other.append({"id": "0", "seconds": 1})
    assert journal.entry("0").record == {"id": "0", "seconds": 1}
    other.append({"id": "0", "damaged": "it is"})
    assert journal.entry("0") == Entry({"id": "0", "seconds": 1}, "it is")
    other.append({"id": "0", "seconds": 2})
    assert journal.entry("0") == Entry({"id": "0", "seconds": 2})
    (tmp_path / "new").write_text('{"id": "1"}')
    (tmp_path / "new").rename(tmp_path / "frames.jsonl")
    assert list(journal.entries()) == ["1"]


@pytest.mark.parametrize(
    "line", ["", "[]", "null", "3", '"id"', '{"id": 5}', '{"id": null}', "{}", "\x00\xff", '{"id": "9"', "[" * 9999]
)
def test_lines_of_others_are_left_out(prior: cache.Prior, line: str) -> None:
    with (prior.folder / "frames.jsonl").open("a", encoding="latin-1") as file:
        file.write(line + "\n")
    prior.write("2", some_depth(), seconds=0.1)
    assert sorted(cache.load(prior.folder).lines()) == ["0", "1", "2"]


@pytest.mark.parametrize("maps", [None, [], {"depth": None}, {"depth": {"bytes": "many"}}, {"depth": {}}])
def test_records_that_are_none_stop_nothing(prior: cache.Prior, maps: object) -> None:
    prior.journal.append({"id": "0", "maps": maps, "density": "dense", "seconds": True})
    try:
        assert prior.read("0").density > 0
    except DataError as error:
        assert "damaged" in str(error)
    assert prior.figures("density") == pytest.approx([prior.lines()["1"]["density"]])


def test_the_least_that_a_stranger_must_write(tmp_path: Path) -> None:
    home = tmp_path / "cache" / "somewhere" / "theirs-v1"
    codecs.write_depth_png(home / "depth" / "000000.png", some_depth().depth_m)
    (home / "manifest.json").write_text('{"format": 2, "drive": {"path": "../../../street"}}')
    found = cache.only(tmp_path / "cache")
    assert (found.method, found.manifest["key"], found.drive["name"]) == ("theirs", "v1", "somewhere")
    assert (home / found.drive["path"]).resolve() == (tmp_path / "street").resolve()
    assert found.ids() == ["000000"] and found.read("000000").confidence is None


@pytest.mark.parametrize(
    "text",
    [
        '{"format": 2}',
        '{"format": "2", "drive": {"path": "x"}}',
        '{"format": true, "drive": {"path": "x"}}',
        '{"format": 0, "drive": {"path": "x"}}',
        '{"format": 2, "drive": "x"}',
        '{"format": 2, "drive": {}}',
        '{"format": 2, "drive": {"path": 3}}',
        '{"format": 2, "drive": {"path": "x"}, "config": null}',
        '{"format": 2, "drive": {"path": "x"}, "method": null}',
    ],
)
def test_manifests_that_are_none_are_damaged(prior: cache.Prior, text: str) -> None:
    (prior.folder / "manifest.json").write_text(text)
    with pytest.raises(DataError, match="damaged manifest: the `priors build` that made it writes it again"):
        cache.load(prior.folder)
    cache.create(prior.folder, prior.manifest)
    assert cache.load(prior.folder).manifest["method"] == "plane"


def test_a_prior_that_cannot_be_read_is_told_and_the_others_are_found(prior: cache.Prior) -> None:
    other = cache.create(prior.folder.with_name("plane-other"), manifest())
    (other.folder / "manifest.json").write_text("{")
    (prior.folder.parent / "stray.txt").write_text("x")
    told: list[DataError] = []
    assert [found.name for found in cache.find(prior.folder.parent, told.append)] == [prior.name]
    assert len(told) == 1 and "plane-other" in str(told[0])
    with pytest.raises(DataError, match="plane-other"):
        cache.find(prior.folder.parent)


def test_foreign_files_among_the_maps_are_no_frames(prior: cache.Prior) -> None:
    for name in ("Thumbs.db", "._0.png", "notes.txt"):
        (prior.folder / "depth" / name).write_bytes(b"x")
    (prior.folder / "depth" / "folder.png").mkdir()
    assert prior.ids() == ["0", "1"]


def test_a_record_is_json_of_one_line(prior: cache.Prior) -> None:
    lines = (prior.folder / "frames.jsonl").read_text().splitlines()
    assert [json.loads(line)["id"] for line in lines] == ["0", "1"]
    assert set(json.loads(lines[0])["maps"]) == {"depth", "confidence"}
