"""A user's own network for depth from one image: fed, read and aligned by its description."""

from pathlib import Path

import numpy as np
import onnx
import pytest
from test_mono import intrinsics

from priors.errors import DataError
from priors.methods.mono import Mono
from priors.types import Camera, Depth, Frame


def brightness_net(path: Path, size: tuple[int, int] | None = None) -> Path:
    """Write an ONNX network that answers the mean of its input's channels: (1, 3, h, w) -> (1, h, w)."""
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    shape = list(size) if size else ["h", "w"]
    node = helper.make_node("ReduceMean", ["image"], ["answer"], axes=[1], keepdims=0)
    ends = [helper.make_tensor_value_info("image", kind, [1, 3, *shape])]
    ends.append(helper.make_tensor_value_info("answer", kind, [1, *shape]))
    graph = helper.make_graph([node], "brightness", ends[:1], ends[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.save(model, str(path))
    return path


def ramp(size: tuple[int, int] = (48, 80), focal_px: float = 100.0) -> Frame:
    """A frame whose brightness is 1000 times its inverse depth, plus 20: 5 to 20 m."""
    inverse = np.linspace(1 / 20, 1 / 5, size[1], dtype=np.float32)[None] * np.ones((size[0], 1), np.float32)
    image = np.repeat(np.rint(1000 * inverse + 20).astype(np.uint8)[..., None], 3, axis=2)
    known = Depth((1 / inverse) * (np.arange(size[0])[:, None] % 4 == 0))
    readers = {"image": lambda: image, "sparse": lambda: known}
    return Frame("000000", Camera(intrinsics(focal_px, size), size), readers)


@pytest.mark.parametrize("settings_", ["", "size = [96, 160]\n", "size = [96, 200]\nfit = 'pad'\n", "multiple = 32\n"])
def test_a_user_s_network_is_aligned(tmp_path: Path, settings_: str) -> None:
    """Relative disparity with an unknown scale and shift becomes metres, however the image is fed."""
    path = brightness_net(tmp_path / "mine.onnx")
    path.with_suffix(".toml").write_text(f'output = "disparity"\n{settings_}')
    frame = ramp()
    method = Mono(weights=path, align="scale-shift", align_per="frame").resolve(frame)
    assert (method.align_to, method.align_in) == ("sparse", "disparity")
    true_m = 1 / np.linspace(1 / 20, 1 / 5, 80)[None].repeat(48, 0)
    depth = method(frame)
    assert depth.confidence is None
    np.testing.assert_allclose(depth.depth_m[:, 2:-2], true_m[:, 2:-2], rtol=0.03)


def test_the_focal_length_of_a_user_s_network(tmp_path: Path) -> None:
    """Metric depth for a camera of 50 px at the size fed; ours has 100 px, and is fed at half the size: just right."""
    path = brightness_net(tmp_path / "mine.onnx")
    frame = ramp()
    path.with_suffix(".json").write_text('{"output": "metric-depth", "focal_px": 50, "size": [24, 40]}')
    half = Mono(weights=path).resolve(frame)(frame)
    path.with_suffix(".json").write_text('{"output": "metric-depth"}')
    plain = Mono(weights=path).resolve(frame)(frame)
    np.testing.assert_allclose(half.depth_m[:, 2:-2], plain.depth_m[:, 2:-2], rtol=0.05)
    path.with_suffix(".json").write_text('{"output": "metric-depth", "focal_px": 50}')
    np.testing.assert_allclose(Mono(weights=path)(frame).depth_m, 2 * plain.depth_m, rtol=1e-5)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('output = "depth"', "metric-depth, relative-depth, disparity"),
        ('output = "disparity"\nsizes = [1, 2]', "unknown key 'sizes'"),
        ('output = "disparity"\nsize = [0, 2]', "above 0"),
        ('output = "disparity"\nsize = "big"', "2 numbers"),
        ('output = "disparity"\nmean = [1, 2]', "3 numbers"),
        ('output = "disparity"\nfit = "crop"', "stretch or pad"),
        ("output = ", "cannot be read"),
        ('output = "disparity"', "scale-shift"),
    ],
)
def test_wrong_descriptions_are_one_line(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "mine.onnx"
    path.write_bytes(b"")
    path.with_suffix(".toml").write_text(text)
    with pytest.raises(DataError, match=says) as caught:
        Mono(weights=path).resolve(ramp())
    assert "\n" not in str(caught.value)


def test_wrong_files_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no such file"):
        Mono(weights=tmp_path / "no.onnx").resolve(ramp())
    path = tmp_path / "mine.onnx"
    path.write_bytes(b"not a network")
    with pytest.raises(DataError, match=r"mine\.toml"):
        Mono(weights=path).resolve(ramp())
    path.with_suffix(".toml").write_text('output = "metric-depth"')
    with pytest.raises(DataError, match="not an ONNX file that onnxruntime can open"):
        Mono(weights=path).resolve(ramp())(ramp())
    with pytest.raises(DataError, match="only our own network"):
        Mono(weights=path, adapt="lidar")
