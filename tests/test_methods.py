"""Methods: what the base class gives, what the registry holds, that configs check themselves, and their network."""

from collections.abc import Callable
from dataclasses import FrozenInstanceError, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
import tyro
from hypothesis import given
from hypothesis import strategies as st

from priors import methods
from priors.build import BuildReport, prepare
from priors.drives import DriveOptions, open_drive
from priors.errors import DataError, expect, expect_choices
from priors.filters import Filters
from priors.methods._network import Network
from priors.methods.completion import Completion
from priors.methods.lidar import Lidar
from priors.methods.mono import Mono
from priors.methods.stereo import Stereo
from priors.nets import int8, weights
from priors.selection import Selection, held_out, parse_hold_out
from priors.street.config import StreetConfig
from priors.types import Depth, Drive, Frame, Input, Method


@dataclass(frozen=True)
class FlatWorld(Method):
    """The least that a method must have."""

    far_m: float = 30.0

    @property
    def reads(self) -> tuple[Input, ...]:
        return ("image",)

    def resolve(self, frame: Frame) -> "FlatWorld":
        return self

    def __call__(self, frame: Frame) -> Depth:
        return Depth(np.full(frame.camera.size, self.far_m, np.float32))


@dataclass(frozen=True)
class Told(FlatWorld):
    """One that looks at the drive first, and says so."""

    def notes(self) -> list[str]:
        return ["told: the world is flat"]

    def prepare(
        self, drive: Drive, folder: Path, on_note: Callable[[str], None] = lambda line: None
    ) -> Callable[[Frame], Depth]:
        on_note(f"told: {len(drive)} frames")
        return replace(self, far_m=float(len(drive)))


def test_the_least_method_is_built(raw_drive: Path, tmp_path: Path) -> None:
    drive = open_drive(raw_drive)
    notes: list[str] = []
    report: BuildReport = prepare(drive, FlatWorld(), folder=tmp_path).run(on_note=notes.append)
    assert [line["id"] for line in report.built] == list(drive.ids) and not notes
    assert report.prior.name.startswith("flat_world-") and report.prior.manifest["weights"] is None
    assert np.all(report.prior.read(drive.ids[0]).depth_m == 30)


def test_a_method_may_look_at_the_drive_first(raw_drive: Path, tmp_path: Path) -> None:
    drive = open_drive(raw_drive)
    notes: list[str] = []
    job = prepare(drive, Told(), folder=tmp_path)
    prior = job.run(on_note=notes.append).prior
    assert notes == ["told: the world is flat", f"told: {len(drive)} frames"]
    assert np.all(prior.read(drive.ids[0]).depth_m == len(drive))
    notes.clear()
    job.run(on_note=notes.append)
    assert not notes, "nothing is left to do: nothing is said"


def test_a_method_without_its_parts_cannot_be_made() -> None:
    class Lame(Method):
        pass

    with pytest.raises(TypeError, match="abstract"):
        Lame()  # type: ignore[abstract]


@pytest.mark.parametrize("name", methods.names())
def test_the_registry_holds_methods(name: str) -> None:
    kind = methods.config_type(name)
    method = kind()
    assert issubclass(kind, Method) and is_dataclass(kind) and method.name == name
    assert kind.VERSION >= 1
    assert method.unread().keys() < {each.name for each in fields(kind)}
    with pytest.raises(FrozenInstanceError):
        setattr(method, fields(kind)[0].name, None)


WRONG: list[tuple[Callable[[], object], str]] = [
    (lambda: Stereo(max_disparity_px=0), "--stereo.max-disparity-px 0: expected a whole number from 1"),
    (lambda: Stereo(model="magic"), "--stereo.model magic: expected one of auto, classical, cfnet, pcwnet"),  # type: ignore[arg-type]
    (lambda: Stereo(runtime="gpu"), "--stereo.runtime gpu: expected one of auto"),  # type: ignore[arg-type]
    (lambda: Stereo(weights=Path("a.onnx")), "--stereo.weights a.onnx: which network"),
    (lambda: Stereo(offset_px=(1, 2, 3, 4, 5)), "--stereo.offset-px 1 2 3 4 5: expected at most 4"),
    (lambda: Stereo(offset_px=(float("nan"),)), "--stereo.offset-px nan: expected finite"),
    (lambda: Stereo(scale=0.98), "--stereo.scale 0.98: expected"),
    (lambda: Stereo(offset_px=(0,), scale=float("nan")), "--stereo.scale nan: expected"),
    (lambda: Completion(guidance=-1), "--completion.guidance -1: expected 0 or more"),
    (lambda: Completion(reach_px=-1), "--completion.reach-px -1: expected a whole number from 0"),
    (lambda: Completion(size="l"), "--completion.size l: expected one of s, m"),  # type: ignore[arg-type]
    (lambda: Completion(runtime="int8"), "--completion.runtime int8: expected one of auto"),  # type: ignore[arg-type]
    (lambda: Lidar(sweeps=0), "--lidar.sweeps 0: expected a whole number from 1"),
    (lambda: Mono(adapt_s=0), "--mono.adapt-s 0: expected seconds"),
    (lambda: Mono(adapt="magic"), "--mono.adapt magic: expected one of none, lidar"),  # type: ignore[arg-type]
    (lambda: Mono(hold_out="1:2:0"), "--mono.hold-out 1:2:0: expected start:stop:step"),
    (lambda: Mono(hold_out="1:2:3:4"), "--mono.hold-out 1:2:3:4: expected start:stop:step"),
    (lambda: Mono(frames="a"), "--mono.frames a: expected a:b"),
    (lambda: Mono(weights=Path("a.onnx"), adapt="video"), "--mono.adapt video: only our own network"),
    (lambda: Filters(clip=-1), "--clip -1: expected"),
    (lambda: Filters(sky="blue"), "--sky blue: expected one of off, mask"),  # type: ignore[arg-type]
    (lambda: Filters(keep=float("nan")), "--keep nan: expected"),
    (lambda: Selection(frames="a:b"), "--frames a:b: expected a:b, for example"),
    (lambda: Selection(shard="3"), "--shard 3: expected i/n"),
    (lambda: Selection(shard="4/3"), "--shard 4/3: expected i/n"),
    (lambda: Selection(min_motion=float("nan")), "--min-motion nan: expected metres"),
    (lambda: DriveOptions(camera=""), "--camera '': expected a name"),
    (lambda: StreetConfig(seed=-1), "street: seed -1: expected 0 or more"),
    (lambda: StreetConfig.draw(-1), "street: seed -1: expected 0 or more"),
    (lambda: StreetConfig(seed=1, floors=(4, 2)), "street: floors"),
    (lambda: StreetConfig(seed=1, parked_share=1.5), "street: parked_share 1.5: expected 0 to 1"),
    (lambda: StreetConfig(seed=1, haze_m=0), "street: haze_m 0: expected above 0"),
]


@pytest.mark.parametrize(("make", "says"), WRONG, ids=[says for _, says in WRONG])
def test_a_config_refuses_what_cannot_be(make: Callable[[], object], says: str) -> None:
    with pytest.raises(DataError) as caught:
        make()
    assert str(caught.value).startswith(says) and "\n" not in str(caught.value)


def test_choices_are_those_of_the_type() -> None:
    @dataclass(frozen=True)
    class Config:
        kind: Literal["a", "b"] = "a"
        count: Literal[1, 2] = 1
        free: str = "anything"

    expect_choices(Config(free="else"), "x.")
    with pytest.raises(DataError, match=r"^--x\.count 3: expected one of 1, 2$"):
        expect_choices(Config(count=3), "x.")  # type: ignore[arg-type]
    expect(True, "--y", 1, "2")
    with pytest.raises(DataError, match=r"^--y 1: expected 2$"):
        expect(False, "--y", 1, "2")


@given(
    count=st.integers(0, 30),
    parts=st.lists(st.one_of(st.none(), st.integers(-9, 9)), min_size=2, max_size=3).filter(lambda p: p[-1] != 0),
)
def test_what_is_held_out_is_a_slice(count: int, parts: list[int | None]) -> None:
    text = ":".join("" if part is None else str(part) for part in parts)
    indices = list(range(100, 100 + count))
    assert held_out(indices, text) == set(indices[slice(*parts)])
    assert parse_hold_out("none") is None and held_out(indices, "none") == set()


@given(count=st.integers(1, 9), place=st.integers(-12, 12))
def test_one_frame_is_held_out_where_there_is_one(count: int, place: int) -> None:
    indices = range(5, 5 + count)
    if -count <= place < count:
        assert held_out(indices, str(place)) == {indices[place]}
    else:
        with pytest.raises(DataError, match=rf"--mono\.hold-out {place}: expected a position in {count} frames"):
            held_out(indices, str(place))


def test_a_network_is_what_the_method_asks_for(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Stereo().network is None and Completion().network is None and Stereo().weights_digest() is None
    assert Stereo(model="cfnet", runtime="fp32").network == Network("cfnet", "s", "fp32")
    assert Completion(model="mffnet").network == Network("mffnet", "s")
    assert Mono(size="m").network == Network("bts", "m")
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    for network in (Network("cfnet", "s"), Network("mffnet", "s"), Network("bts", "m")):
        resolved = network.resolve()
        assert resolved.runtime != "auto" and resolved.resolve() == resolved
        assert network.digest() == weights.digest(network.file()) == replace(network, runtime="fp32").digest()
    with pytest.raises(DataError, match="no weights for cfnet in size l"):
        Network("cfnet", "l").digest()


def test_the_ranges_of_int8_decide_too() -> None:
    network = Network("cfnet", "s", "int8")
    assert network.digest() == int8.digest(network.file()) != Network("cfnet", "s", "fp32").digest()


def test_flags_are_the_fields_names() -> None:
    """The network's settings are the method's own flags, as they have always been."""

    @dataclass(frozen=True)
    class Arguments:
        stereo: Stereo = Stereo()  # noqa: RUF009 - frozen
        mono: Mono = Mono()  # noqa: RUF009

    given = [
        "--stereo.model",
        "cfnet",
        "--stereo.runtime",
        "onnx",
        "--stereo.size",
        "m",
        "--mono.weights",
        "a.safetensors",
    ]
    made: Any = tyro.cli(Arguments, args=given)
    assert made.stereo.network == Network("cfnet", "m", "onnx")
    assert made.mono.network == Network("bts", "m", "auto", Path("a.safetensors"))


def test_a_map_without_confidence_says_so() -> None:
    with pytest.raises(DataError, match="no confidence"):
        Depth(np.ones((2, 2), np.float32)).trust()
