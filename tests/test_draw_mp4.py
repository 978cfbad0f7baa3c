"""Videos, read back: codec, size, number of pictures, their colours and their order."""

import errno
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from priors.draw import mp4
from priors.draw.mp4 import even, write_mp4
from priors.errors import DataError


def picture(number: int = 0, size: tuple[int, int] = (64, 96)) -> np.ndarray:
    """A red ramp to the right, a green one downwards, and a blue square that moves with the number."""
    height, width = size
    image = np.zeros((height, width, 3), np.uint8)
    image[..., 0] = np.linspace(20, 220, width)
    image[..., 1] = np.linspace(30, 200, height)[:, None]
    left = 8 * number % (width - 16)
    image[4:20, left : left + 16] = (10, 10, 240)
    return image


def read(path: Path) -> tuple[av.VideoStream, list[np.ndarray]]:
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        return stream, [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]


@pytest.mark.parametrize("size", [(64, 96), (63, 95), (376, 1242)])
def test_a_video_is_what_browsers_play_and_shows_the_pictures(tmp_path: Path, size: tuple[int, int]) -> None:
    path = tmp_path / "new" / "a.mp4"
    given_ = [picture(number, size) for number in range(5)]
    assert write_mp4(path, iter(given_), 12.5) == 5
    stream, seen = read(path)
    context = stream.codec_context
    assert (context.name, context.pix_fmt) == ("h264", "yuv420p")
    assert (context.height, context.width) == (size[0] + size[0] % 2, size[1] + size[1] % 2)
    assert (context.colorspace, context.color_primaries, context.color_trc, context.color_range) == (1, 1, 1, 1)
    assert stream.average_rate == 12.5
    assert len(seen) == stream.frames == 5
    for ours, theirs in zip(given_, seen, strict=True):
        difference = np.abs(theirs.astype(int) - even(ours))
        assert difference.mean() < 2.5, "on the whole"
        assert np.percentile(difference, 99) < 30, "edges of colour, which 4:2:0 blurs"
        assert np.abs((theirs.astype(int) - even(ours)).mean(axis=(0, 1))).max() < 2, "no tint"
    assert [item.name for item in path.parent.iterdir()] == ["a.mp4"]


def test_the_index_stands_first(tmp_path: Path) -> None:
    write_mp4(tmp_path / "a.mp4", [picture()], 10)
    data = (tmp_path / "a.mp4").read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 9), st.integers(1, 9))
def test_even_adds_at_most_a_row_and_a_column(height: int, width: int) -> None:
    image = np.arange(height * width * 3, dtype=np.uint8).reshape(height, width, 3)
    made = even(image)
    assert made.shape[0] % 2 == made.shape[1] % 2 == 0
    assert (made[:height, :width] == image).all()
    assert (made[-1, :width] == image[-1]).all()
    assert (made[:height, -1] == image[:, -1]).all()


def test_what_cannot_be_written_is_told_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DataError, match=r"a.avi: expected a name that ends in .mp4"):
        write_mp4(tmp_path / "a.avi", [picture()], 10)
    with pytest.raises(DataError, match=r"a.mp4: no pictures to write"):
        write_mp4(tmp_path / "a.mp4", [], 10)
    with monkeypatch.context() as patched:
        patched.setattr(mp4, "ENCODER", "no-such-encoder")
        with pytest.raises(DataError, match="PyAV was built without no-such-encoder"):
            write_mp4(tmp_path / "a.mp4", [picture()], 10)
    with pytest.raises(KeyboardInterrupt):
        write_mp4(tmp_path / "a.mp4", interrupted(), 10)
    assert not list(tmp_path.iterdir())


def interrupted():  # type: ignore[no-untyped-def]
    yield picture()
    raise KeyboardInterrupt


def test_a_full_disk_leaves_the_old_video_and_names_it(tmp_path: Path, full_disk) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "a.mp4"
    write_mp4(path, [picture()], 10)
    old = path.read_bytes()
    noise = np.random.default_rng(0).integers(0, 256, (20, 64, 96, 3), dtype=np.uint8)
    with full_disk(20_000), pytest.raises(OSError) as told:
        write_mp4(path, iter(noise), 10)
    assert told.value.filename == str(path)
    assert told.value.errno == errno.EFBIG
    assert path.read_bytes() == old
    assert [item.name for item in tmp_path.iterdir()] == ["a.mp4"]
