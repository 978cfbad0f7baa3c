"""The study's three families of fields, one file each: what differs is the space, the samplers and the extra losses."""

from dataclasses import dataclass
from importlib import import_module

from nerf.space import Kind
from priors import extensions

__path__.extend(extensions.folders("fields"))


@dataclass(frozen=True)
class Family:
    """What makes a family; everything else is shared."""

    space: Kind
    """How the world is folded into the grid."""
    proposals: tuple[int, ...] = ()
    """Candidates per ray of each proposal round before the field's own samples; none: the occupancy grid alone."""
    anti_aliased: bool = False
    """Ask the grid for a sample's extent, not for a point: levels finer than a pixel's cone fade."""
    distortion: float = 1.0
    """How much more the distortion loss weighs than usual."""


def names() -> list[str]:
    """List the families."""
    return extensions.names(__path__)


def family(name: str) -> Family:
    """Return a family by its file's name."""
    found: Family = import_module(f"{__name__}.{name}").FAMILY
    return found
