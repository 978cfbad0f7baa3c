"""MP4 videos: H.264 in 4:2:0 (yuv420p), which every browser plays, by PyAV.

Colours are tagged BT.709, so that players show what was given: without a tag each guesses by the picture's size. The
index stands first in the file, so that a browser starts before it has the whole.
"""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from eval.files import write_atomically
from priors.errors import DataError
from priors.machine import threads
from priors.types import Image

if TYPE_CHECKING:  # PyAV is imported when a video is written
    from av.container import OutputContainer
    from av.video.stream import VideoStream

ENCODER = "libx264"
QUALITY = {"crf": "18", "preset": "medium"}
"""Constant rate factor: 18 looks like the original."""
BT709, LIMITED = 1, 1
"""ITU-T H.273's numbers: of the primaries, the transfer and the matrix; FFmpeg's of a range of 16 to 235."""


def write_mp4(path: Path, pictures: Iterable[Image], fps: float) -> int:
    """Write RGB pictures (height, width, 3) of one size, atomically; an odd side is made even by repeating its edge.

    Returns:
        How many pictures it has.

    Raises:
        DataError: the name does not end in .mp4, there is no picture, or PyAV lacks its encoder.
        OSError: the disk is full.
    """
    if path.suffix.lower() != ".mp4":
        raise DataError(f"{path}: expected a name that ends in .mp4")
    count = 0

    def write(temporary: Path) -> None:
        nonlocal count
        count = _encode(temporary, pictures, fps)
        if not count:
            raise DataError(f"{path}: no pictures to write")

    write_atomically(path, write)
    return count


def even(picture: Image) -> Image:
    """Repeat the last row or column of a side that is odd: 4:2:0 halves both sides of its colours."""
    height, width = picture.shape[:2]
    return np.pad(picture, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def _encode(path: Path, pictures: Iterable[Image], fps: float) -> int:
    """Encode pictures as they come; returns their number."""
    import av

    count, stream = 0, None
    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as container:
        for picture in map(even, pictures):
            stream = stream or _stream(container, picture, fps)
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            frame = frame.reformat(format="yuv420p", dst_colorspace=BT709)
            container.mux(stream.encode(frame))
            count += 1
        if stream is not None:
            container.mux(stream.encode())
    return count


def _stream(container: "OutputContainer", picture: Image, fps: float) -> "VideoStream":
    """Add the video's stream, of a picture's size."""
    import av

    try:
        added = container.add_stream(ENCODER, rate=Fraction(fps).limit_denominator(1001), options=QUALITY)
    except av.codec.codec.UnknownCodecError as error:
        raise DataError(f"PyAV was built without {ENCODER}, its encoder of H.264: pip install --upgrade av") from error
    stream = cast("VideoStream", added)
    stream.height, stream.width = picture.shape[:2]
    stream.pix_fmt = "yuv420p"
    context = stream.codec_context
    context.thread_count = threads.count()
    context.color_primaries = context.color_trc = context.colorspace = BT709
    context.color_range = LIMITED
    return stream
