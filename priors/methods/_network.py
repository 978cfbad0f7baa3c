"""The network of a method: which one, in which size, with whose weights, and what runs it."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Self

from priors.recalibration import Recalibration

if TYPE_CHECKING:  # keeps PyTorch out of --help
    from priors.nets.graphs import Portable
    from priors.nets.runtime import Asked, Floating, Ready, Runtime


@dataclass(frozen=True)
class Network:
    """A network to use; a method makes it of its fields of the same names."""

    model: str
    """Its module in priors/nets."""
    size: str
    """s, m or l: small is faster, large is better."""
    runtime: "Asked" = "auto"
    """What runs it; auto: CUDA where there is one, else what a table says is fastest on this CPU."""
    weights: Path | None = None
    """The user's weights; None: those that come with the package."""

    def decide(self) -> "Runtime":
        """Return what runs it here; DataError where what was asked for is not there."""
        from priors.nets import runtime

        return runtime.choose(self.runtime, self.weights, self.model, self.size)

    def decide_floating(self) -> "Floating":
        """Return what runs it here, for networks that do not run on integers."""
        from priors.nets import runtime

        return runtime.choose_floating(self.runtime, self.weights, self.model)

    def resolve(self) -> Self:
        """Return it with the runtime decided."""
        return replace(self, runtime=self.decide())

    def file(self) -> Path:
        """Return the file of its weights; DataError where it is missing."""
        from priors.nets import weights

        return weights.find(self.model, self.size, self.weights)

    def digest(self) -> str:
        """Return the hash of what decides its answers: the weights, and for int8 the ranges that were measured."""
        from priors.nets import int8, weights

        return (int8 if self.runtime == "int8" else weights).digest(self.file())

    def recalibration(self) -> Recalibration:
        """Return what mends its confidences: what was fitted for these very weights, whatever runs them."""
        from priors.nets import weights

        file = self.file()
        return Recalibration.of(file.stem, weights.digest(file))

    def open(self) -> "Ready | Portable":
        """Load it, once a process for each file and runtime; DataError where its weights are missing or damaged.

        With the runtime onnx it must be a network of one image; stereo networks have their own graphs.
        """
        from priors.nets import graphs, runtime

        chosen = self.decide()
        if chosen == "onnx":
            return graphs.open_portable(self.model, self.size, self.weights)
        return runtime.open_net(self.model, self.size, chosen, self.weights)
