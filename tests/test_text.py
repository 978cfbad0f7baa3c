"""Text as people's programs leave it: marks, encodings, line ends, comments."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from priors.errors import DataError
from priors.text import read_json, read_lines, read_text

TEXT = "fx: 1.5\n\n# a comment\n2 3 # of a line\n"


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r\r\n", "\r"])
def test_every_editors_text_is_the_same(tmp_path: Path, encoding: str, end: str) -> None:
    (tmp_path / "a.txt").write_bytes(TEXT.replace("\n", end).encode(encoding))
    assert read_text(tmp_path / "a.txt") == TEXT
    assert [(line.number, line.text) for line in read_lines(tmp_path / "a.txt")] == [
        (1, "fx: 1.5"),
        (2, ""),
        (4, "2 3"),
    ]


@given(st.binary(max_size=20).filter(lambda data: b"\0" not in data and b"\n" not in data and b"\r" not in data))
def test_the_bytes_of_a_comment_do_not_matter(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    """0x85 ends a line for Python's splitlines in Latin-1; it is the dots of Windows' encoding."""
    path = tmp_path_factory.mktemp("text") / "a.txt"
    path.write_bytes(b"# " + data + b"\n1 2 3\n")
    assert [line.words for line in read_lines(path)] == [["1", "2", "3"]]


def test_a_hash_inside_a_word_is_no_comment(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("frame#7 1\n")
    assert read_lines(tmp_path / "a.txt")[0].words == ["frame#7", "1"]


def test_what_is_no_text_is_told(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such file"):
        read_text(tmp_path / "a.txt")
    (tmp_path / "a.txt").write_bytes(b"\x89PNG\r\n" + bytes(9))
    with pytest.raises(DataError, match="is not text"):
        read_text(tmp_path / "a.txt")
    for text, told in (("{", "damaged JSON"), ("[1]", "expected a JSON object, found list")):
        (tmp_path / "a.json").write_text(text)
        with pytest.raises(DataError, match=told):
            read_json(tmp_path / "a.json")
