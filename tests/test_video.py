"""`priors video`: what is in the file, flicker in the titles, and one line for what cannot be shown."""

from pathlib import Path

import pytest
from installed import fail, succeed

from cli.priors.video import picture
from priors import build
from priors.drives import open_drive
from priors.methods.lidar import Lidar
from priors.selection import Selection


def test_a_frame_has_a_picture_for_each_prior(street: Path, tmp_path: Path) -> None:
    drive = open_drive(street)
    job = build.prepare(drive, Lidar(sweeps=1), folder=tmp_path)
    depth = job.run(job.plan(Selection(frames="0:1"))).prior.read(drive.ids[0])
    alone = picture(drive[0], [("lidar", depth)], 1, 208)
    both = picture(drive[0], [("lidar", depth), ("none", None)], 1, 208)
    assert both.shape[0] > alone.shape[0] and both.shape[1] == alone.shape[1]
    assert (both[: alone.shape[0]] == alone).all()
    assert not both[-64 - 6 : -6, 6:-6].any()  # dark where a prior has no map
    assert picture(drive[0], [("lidar", depth)], 2, 208).shape[1] > alone.shape[1]


def test_the_command_writes_a_video(street: Path, tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    for sweeps in (1, 3):
        succeed("build", street, "--method", "lidar", "--lidar.sweeps", sweeps, "--frames", "0:3", cwd=tmp_path)
    told = succeed("video", "--flicker", "--width", 208, "--fps", 5, cwd=tmp_path)
    assert told.count("flicker 0.") == 2 and "3 frames" in told
    with av.open(str(tmp_path / "depth.mp4")) as video:
        stream = video.streams.video[0]
        shown = [frame.to_ndarray(format="rgb24") for frame in video.decode(stream)]
        assert len(shown) == 3 and stream.average_rate == 5 and stream.codec_context.name == "h264"
    assert shown[0].shape == shown[2].shape and (shown[0] != shown[2]).any()


@pytest.mark.slow
def test_what_cannot_be_shown_is_one_line(street: Path, own_street: Path, tmp_path: Path) -> None:
    succeed("build", street, "--method", "lidar", "--lidar.sweeps", 1, "--frames", "0:1", cwd=tmp_path)
    assert ".mp4" in fail("video", "--out", "depth.avi", cwd=tmp_path, code=2)
    assert "--fps" in fail("video", "--fps", 0, cwd=tmp_path, code=2)
    assert "neighbouring frames" in fail("video", "--flicker", cwd=tmp_path)
    assert "no frames there" in fail("video", "--frames", "90:95", cwd=tmp_path, code=2)
