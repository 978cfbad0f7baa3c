"""Who takes part in a bench: baselines match what they are named after, ours are all that have weights."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from factories import depth_m, scene, write_folder

from priors.bench import entrants
from priors.bench.baselines import Recipe, Sgbm, fill
from priors.bench.psmnet import Psmnet
from priors.drives import DriveOptions, open_drive
from priors.errors import DataError
from priors.methods.mono import Mono
from priors.methods.stereo import Stereo
from priors.nets.weights import FOLDER

pytestmark = pytest.mark.stress


@pytest.mark.parametrize(("halvings", "error"), [(0, 0.02), (1, 0.04)])
def test_sgbm_finds_the_scene(tmp_path: Path, halvings: int, error: float) -> None:
    frame = open_drive(write_folder(tmp_path))[0]
    depth = Sgbm(halvings=halvings).resolve(frame)(frame)
    true_m = depth_m(scene()[2])
    assert depth.valid.mean() > 0.6
    off = np.abs(depth.depth_m - true_m)[depth.valid] / true_m[depth.valid]
    assert np.median(off) < error


def test_sgbm_sees_from_the_right_camera_too(raw_drive: Path) -> None:
    frame = open_drive(raw_drive, options=DriveOptions(camera="image_03"))[0]
    depth = Sgbm(offset_px=(0, 0, 0, 0)).resolve(frame)(frame)
    assert depth.valid[:, :200].mean() > 0.6  # what the left camera does not see is on the right
    pair = scene()[2]
    found_px = frame.camera.fx * frame.baseline_m / depth.depth_m[depth.valid]
    assert np.median(np.abs(found_px - pair[depth.valid])) < 0.5


def test_the_recipe_fills_near_surfaces_first() -> None:
    sparse_m = np.zeros((60, 80), np.float32)
    sparse_m[30:50:4, 10:70:5] = 20
    sparse_m[32:50:4, 40:70:5] = 8
    full_m = fill(sparse_m)
    assert (full_m[:48, 8:72] > 0).all()  # up to the top, and between
    assert full_m[40, 20] == pytest.approx(20, abs=0.5) and full_m[40, 60] < 10
    assert not fill(np.zeros((20, 30), np.float32)).any()
    assert np.array_equal(entrants.BASELINES[2][1](_Sparse(sparse_m)).depth_m, full_m)


class _Sparse:
    """As much of a frame as the recipe reads."""

    def __init__(self, sparse_m: np.ndarray) -> None:
        self.depth_m = sparse_m

    def sparse(self) -> "_Sparse":
        return self


def test_ours_are_every_model_size_and_runtime_that_has_weights() -> None:
    names = [each.name for each in entrants.field_size()]
    assert len(set(names)) == len(names)
    shipped = {path.stem for path in FOLDER.glob("*.safetensors")}
    assert {"lidar", "completion", "stereo", "mono m fp32", "stereo cfnet-s bf16", "stereo cfnet-s int8"} <= set(names)
    assert not [name for name in names if "cfnet-m" in name]  # has no weights
    for net in ("cfnet-s", "pcwnet-s", "mffnet-s"):
        assert (net in shipped) == any(net in name for name in names)
    usual = entrants.field_size(["auto"])
    assert [each.name for each in usual if "stereo" in each.name] == ["stereo", "stereo cfnet-s", "stereo pcwnet-s"]
    assert all(getattr(each.method, "runtime", "auto") == "auto" for each in usual)


def test_an_entrant_is_known_by_what_decides_its_maps() -> None:
    one, same, other = (entrants.Entrant("x", Stereo(max_disparity_px=most)) for most in (64, 64, 32))
    assert one.identity() == same.identity() != other.identity()
    assert entrants.Entrant("y", Recipe()).family == "recipe"


def test_weights_of_ours_say_what_they_are(tmp_path: Path) -> None:
    own = tmp_path / "mine.safetensors"
    own.write_bytes((FOLDER / "cfnet-s.safetensors").read_bytes())
    entrant = entrants.network(own)
    assert isinstance(entrant.method, Stereo) and entrant.method.model == "cfnet" and entrant.kind == "own"
    own.write_bytes((FOLDER / "bts-m.safetensors").read_bytes())
    assert isinstance(entrants.network(own).method, Mono)


def test_a_described_network_of_one_image_is_aligned_where_it_has_no_scale(tmp_path: Path) -> None:
    file = tmp_path / "mine.onnx"
    file.write_bytes(b"any")
    (tmp_path / "mine.json").write_text(json.dumps({"output": "disparity"}))
    method = entrants.network(file).method
    assert isinstance(method, Mono) and (method.align, method.align_per) == ("scale-shift", "frame")


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("none.onnx", None, "no such file"),
        ("mine.pth", b"x", "ends in .onnx or .safetensors"),
        ("mine.safetensors", b"x", "damaged, or no safetensors"),
        ("mine.onnx", b"x", "no stereo graph of ours"),
    ],
)
def test_what_is_no_network_is_told_in_a_line(tmp_path: Path, name: str, content: bytes | None, told: str) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(DataError, match=told) as error:
        entrants.network(tmp_path / name)
    assert "\n" not in str(error.value)


PEER = """
import torch


class PSMNet(torch.nn.Module):
    def __init__(self, disparities):
        super().__init__()
        self.shift_px = torch.nn.Parameter(torch.zeros(1))

    def forward(self, left, right):
        assert left.shape == right.shape and left.shape[2] % 32 == left.shape[3] % 32 == 0 and left.shape[3] >= 256
        return self.shift_px.expand(1, *left.shape[2:])
"""


def test_psmnet_is_run_from_the_user_s_files(tmp_path: Path) -> None:
    import torch

    frame = open_drive(write_folder(tmp_path / "drive"))[0]
    (tmp_path / "peer.py").write_text(PEER)
    torch.save({"state_dict": {"module.shift_px": torch.tensor([5.0])}}, tmp_path / "weights.tar")
    entrant = entrants.psmnet(tmp_path / "peer.py", tmp_path / "weights.tar")
    depth = entrant.method(frame)
    assert np.allclose(depth.depth_m, frame.camera.fx * frame.baseline_m / 5)
    with pytest.raises(DataError, match="--psmnet"):
        entrants.psmnet(tmp_path / "peer.py", tmp_path / "none.tar")
    (tmp_path / "weights.tar").write_bytes(b"x")
    with pytest.raises(DataError, match="expected PSMNet's weights"):
        Psmnet(tmp_path / "peer.py", tmp_path / "weights.tar")(frame)


def test_nothing_to_match_leaves_the_map_empty(tmp_path: Path) -> None:
    drive = open_drive(write_folder(tmp_path))
    for side in ("left", "right"):
        for path in (tmp_path / side).iterdir():
            cv2.imwrite(str(path), np.full((96, 240, 3), 90, np.uint8))
    assert not Sgbm(offset_px=(0, 0, 0, 0)).resolve(drive[0])(drive[0]).valid.any()
