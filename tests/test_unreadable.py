"""A file that is there and cannot be read: every reader names it, says why, and what to do."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from priors import codecs, text
from priors.cache import manifest
from priors.drives import _files, _ply, _velodyne
from priors.errors import DataError, unreadable
from priors.nets import weights

READERS: dict[str, Callable[[Path], object]] = {
    "image": codecs.read_image,
    "depth": codecs.read_depth_png,
    "text": text.read_text,
    "sweep": _velodyne.read_sweep_file,
    "ply": _ply.read_ply,
    "digest": lambda path: _files.digest([path]),
}


@pytest.mark.parametrize("name", READERS)
def test_a_folder_in_a_file_s_place_is_told_with_the_mend(tmp_path: Path, name: str) -> None:
    place = tmp_path / "here.bin"
    place.mkdir()
    with pytest.raises(DataError, match=r"here\.bin: cannot be read \(Is a directory\): it is a folder: name a file$"):
        READERS[name](place)


@pytest.mark.parametrize("name", READERS)
def test_a_file_that_is_not_there_is_told_so(tmp_path: Path, name: str) -> None:
    with pytest.raises(DataError, match=r"gone\.bin: no such file$"):
        READERS[name](tmp_path / "gone.bin")


def test_each_kind_of_error_has_its_mend(tmp_path: Path) -> None:
    denied = unreadable(tmp_path / "a", PermissionError(13, os.strerror(13)))
    assert (
        str(denied) == f"{tmp_path / 'a'}: cannot be read (Permission denied): you may not read it: chmod u+r lets you"
    )
    broken = unreadable("a", OSError(5, os.strerror(5)))
    assert str(broken) == "a: cannot be read (Input/output error): copy or download it again"


def test_a_manifest_and_weights_too(tmp_path: Path) -> None:
    (tmp_path / "manifest.json").mkdir()
    with pytest.raises(DataError, match=r"manifest\.json: cannot be read"):
        manifest.read(tmp_path)
    with pytest.raises(DataError, match="no such file"):
        weights.digest(tmp_path / "w.safetensors")
