"""Entrants: who takes part in a bench. Every method with its models, sizes and runtimes, baselines, the user's own."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal, get_args, get_type_hints

from priors import methods
from priors.bench.baselines import Recipe, Sgbm
from priors.bench.psmnet import Psmnet
from priors.errors import DataError
from priors.keys import key_of
from priors.methods._network import Network
from priors.methods.completion import Completion
from priors.methods.mono import Mono
from priors.methods.stereo import Stereo
from priors.records import original, record
from priors.types import Frame, Method

AUTO = "auto"
CHOICES = ("model", "size", "runtime")
"""Fields of a method whose every choice is an entrant."""
USUAL_MODEL = "classical"
"""What a method's name alone stands for."""
BASELINES = (("SGBM", Sgbm()), ("SGBM half", Sgbm(halvings=1)), ("recipe (IP-Basic)", Recipe()))
Kind = Literal["method", "baseline", "own"]


@dataclass(frozen=True)
class Entrant:
    """A way to make depth, and what tables call it."""

    name: str
    method: Method
    kind: Kind = "method"
    """One of ours, a baseline, or the user's own network; --budget chooses among ours alone."""

    @property
    def family(self) -> str:
        """What a plot joins and colours: the method and its model."""
        model = getattr(self.method, "model", "")
        return f"{self.method.name} {model}".strip()

    def lacks(self, frame: Frame) -> str | None:
        """Say why it cannot work on a frame; None where it can."""
        lacking = next((what for what in self.method.reads if not frame.has(what)), None)
        return None if lacking is None else frame.missing.get(lacking, f"the drive has no {lacking}")

    def identity(self) -> str:
        """Return a hash of what decides its maps and its time: settings, version, weights."""
        method = self.method
        parts = {"method": method.name, "version": method.VERSION, "weights": method.weights_digest()}
        return key_of(parts | {"config": original(type(method), record(method))})


def kinds() -> list[str]:
    """List the methods that enter: those that join the maps of others take what those take, and are left out."""
    return [name for name in methods.names() if not methods.config_type(name).JOINS]


def field_size(runtimes: Sequence[str] | None = None) -> list[Entrant]:
    """List all entrants of ours: each method's usual settings, and each model, size and runtime that has weights.

    Args:
        runtimes: those to enter; None: every one that runs here.
    """
    return [Entrant(_name(each), each) for kind in kinds() for each in presets(kind, runtimes)]


def baselines() -> list[Entrant]:
    """List what others do."""
    return [Entrant(name, method, "baseline") for name, method in BASELINES]


def psmnet(code: Path, weights: Path) -> Entrant:
    """Return PSMNet, from two files; DataError where one cannot be read."""
    entrant = Entrant("PSMNet", Psmnet(code, weights), "baseline")
    entrant.identity()
    return entrant


def network(file: Path) -> Entrant:
    """Return a user's network: weights of one of ours (.safetensors), a stereo graph of ours or any one-image network.

    Raises:
        DataError: the file is missing or is none of these.
    """
    if not file.is_file():
        raise DataError(f"{file}: no such file: name a network's .onnx or .safetensors file")
    if file.suffix not in (".onnx", ".safetensors"):
        raise DataError(f"{file}: expected a network's file that ends in .onnx or .safetensors")
    return Entrant(str(file), _foreign(file) if file.suffix == ".onnx" else _of_weights(file), "own")


def presets(name: str, runtimes: Sequence[str] | None = None) -> list[Method]:
    """List a method's settings, the usual ones first: each choice of CHOICES that has an effect, and weights."""
    kind = methods.config_type(name)
    hints, found = get_type_hints(kind), [kind()]
    for field in (field.name for field in fields(kind) if field.name in CHOICES):
        options = [option for option in get_args(hints[field]) if option != AUTO]
        if field == "runtime" and runtimes is not None:
            options = [option for option in (*options, AUTO) if option in runtimes]
        found = [each for method in found for each in _varied(method, field, options)]
    return [method for method in found if _can_run(method)]


def _varied(method: Method, field: str, options: Sequence[Any]) -> list[Method]:
    """Return a method with each choice of a field; as it is where the field has no effect."""
    if field in method.unread() or not options:
        return [method]
    return [replace(method, **{field: option}) for option in options]


def _can_run(method: Method) -> bool:
    """Tell whether a method's network, if it has one, has weights that come with the package and runs here."""
    try:
        method.weights_digest()
        network = getattr(method, "network", None)
        if isinstance(network, Network):
            network.decide()
    except DataError:
        return False
    return True


def _name(method: Method) -> str:
    """Name a method by its model, size and runtime, where these have an effect: 'stereo cfnet-s bf16'."""
    choice = {field: getattr(method, field) for field in CHOICES if hasattr(method, field)}
    choice = {field: value for field, value in choice.items() if field not in method.unread()}
    model = choice.get("model", "")
    network = "" if model == USUAL_MODEL else "-".join(part for part in (model, choice.get("size", "")) if part)
    runtime = choice.get("runtime", "")
    return " ".join(part for part in (method.name, network, "" if runtime == AUTO else runtime) if part)


def _foreign(file: Path) -> Method:
    """Return the method that runs an ONNX file: a stereo graph of ours says so in its header."""
    from priors.methods._mono_description import describe

    if not any(file.with_suffix(suffix).is_file() for suffix in (".toml", ".json")):
        return Stereo(model=_net_of(_graph_header(file), file), weights=file)
    output = describe(file).output
    return Mono(weights=file, align="none" if output == "metric-depth" else "scale-shift", align_per="frame")


def _graph_header(file: Path) -> dict[str, Any]:
    from priors.nets.export import Graph

    try:
        return Graph(file).about
    except DataError as error:
        told = "or describe it in a .toml file of its name (docs/methods/mono.md)"
        raise DataError(f"{file}: no stereo graph of ours: export it by `priors export --to onnx`, {told}") from error


def _of_weights(file: Path) -> Method:
    """Return the method of a .safetensors file of ours, by its header."""
    from priors.nets.weights import read_about

    about = read_about(file)
    net, size = about.get("net"), about.get("size", "s")
    if net == "bts":
        return Mono(weights=file, size=size)
    if net == "mffnet":
        return Completion(model="mffnet", weights=file, size=size)
    return Stereo(model=_net_of(about, file), weights=file, size=size)


def _net_of(about: dict[str, Any], file: Path) -> Any:
    """Return the stereo network that a header names."""
    known = [model for model in get_args(get_type_hints(Stereo)["model"]) if model not in (USUAL_MODEL, AUTO)]
    if about.get("net") not in known:
        raise DataError(f"{file}: its header names the network {about.get('net')!r}: expected {', '.join(known)}")
    return about["net"]
