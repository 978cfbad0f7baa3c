"""Model protocol: what `fit` trains, `checkpoint` keeps and `report` renders, whatever its family is.

A family is a file in nerf/fields/. It may march rays through a hash grid (nerf/volumetric.py) or do something else:
nothing outside of a family asks how.
"""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from torch import Tensor

from nerf.config import FitConfig, ModelConfig
from nerf.gaussians.types import Gaussians
from nerf.scene import Scene
from nerf.types import RenderedView
from priors.types import Camera, Matrix


@dataclass(frozen=True, slots=True)
class StepResult:
    """What a training step leaves to tell; tensors may be on a GPU, and looking at them waits for it."""

    terms: dict[str, Tensor]
    """The batch's losses, unweighted scalars; `rgb`, the mean squared error of the colours in [0, 1], among them."""
    total: Tensor
    """Their weighted sum."""
    rays: int
    """Rays of the batch."""
    samples: int
    """Places at which the field was asked."""


class Model(Protocol):
    """A model of one scene; poses are in the scene's frame (priors/origin.py)."""

    @property
    def config(self) -> ModelConfig:
        """What was trained."""

    def train(self, scene: Scene, config: FitConfig, step: int, progress: float) -> StepResult:
        """Draw a batch, go forward and back, and move the parameters.

        Args:
            scene: what it learns; the same in every step.
            config: losses, rates, rays; its seed and `step` (from 0) decide everything random.
            step: number of the step.
            progress: spent share of the fit's budget, [0, 1).
        """

    def render(self, T_world_cam: Matrix, camera: Camera) -> RenderedView:
        """Render a view."""

    def parameters(self) -> dict[str, Tensor]:
        """Return the trainable tensors by name."""

    def state(self) -> dict[str, Tensor]:
        """Return every tensor that a checkpoint keeps, by name: with them training goes on bit for bit."""

    def load(self, state: dict[str, Tensor]) -> None:
        """Take over a saved state; ValueError, naming a tensor, where it is another model's."""

    def record(self) -> dict[str, Any]:
        """Return what else `Family.open` needs to make this model again; anything JSON holds."""


@runtime_checkable
class ShowsScene(Protocol):
    """A model that renders from its scene's frames, not from its checkpoint alone."""

    def show(self, scene: Scene) -> None:
        """Take the frames; DataError where they are not those that the model was made of."""


@runtime_checkable
class GoesOn(Protocol):
    """A family whose models are begun from what a checkpoint recorded, where there is one: as an earlier version made
    them, if it was made by one."""

    def go_on(self, scene: Scene, config: FitConfig, record: dict[str, Any], device: str) -> Model:
        """Make a model of a scene that is ready to load a checkpoint with this record, and to train on."""


@runtime_checkable
class HoldsGaussians(Protocol):
    """A model that is made of Gaussians, as other programs show them."""

    def splats(self) -> Gaussians:
        """Return all that it shows, the sky too, as Gaussians of the scene's frame."""


class Family(Protocol):
    """What a file in nerf/fields/ offers as FAMILY.

    `unread`, where a family has it, names the settings of a fit that do nothing in it, dotted: "model.width", or all of
    "model.sampler". `nerf fit` refuses their flags.

    `rays_growth`, where a family has it, is how many times as many rays a step with a prior has when a fit ends as
    when it begins, where nobody says. Its models ask `config.rays_at`.

    A family whose models learn nothing says so: `trained = False`. Its models have no parameters, a fit makes them at
    once, and a study makes them once a prior, whatever the losses and seeds are.
    """

    def start(self, scene: Scene, config: FitConfig, device: str) -> Model:
        """Make an untrained model of a scene."""

    def open(self, config: ModelConfig, record: dict[str, Any], state: dict[str, Tensor], device: str) -> Model:
        """Make a model again of what a checkpoint holds: its config, `record` and `state`."""
