"""Flags of commands that can work on several machines."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from priors.errors import UsageError, expect, expect_between
from priors.machine.threads import MOST_THREADS

if TYPE_CHECKING:  # keeps the engine out of --help
    from nerf.run import FitElsewhere
    from priors.scale.ray_session import Share
    from priors.scale.scoring import RayScorer

TYPED = ("address", "cpus_per_worker", "gpus_per_worker")
"""Flags that only a cluster reads."""


@dataclass(frozen=True)
class EngineArguments:
    """Where the work is done."""

    engine: Literal["local", "ray"] = "local"
    """local: in this process; ray: by processes on the nodes of a Ray cluster, or on this machine's cores. It needs the
    extra cluster: docs/scale.md."""
    address: str | None = None
    """Of the Ray cluster: auto, HOST:PORT or ray://HOST:PORT; default: one starts here, and ends with the command."""
    cpus_per_worker: int = 2
    """Cores of each of its processes."""
    gpus_per_worker: float = 0.0
    """GPUs of each of its processes; 0.5: two share one."""

    def __post_init__(self) -> None:
        expect_between(1, self.cpus_per_worker, MOST_THREADS, "--cpus-per-worker")
        expect(0 <= self.gpus_per_worker < float("inf"), "--gpus-per-worker", self.gpus_per_worker, "0 or more")
        for name in TYPED if self.engine == "local" else ():
            if getattr(self, name) != getattr(type(self), name):
                raise UsageError(f"--{name.replace('_', '-')}: is read with --engine ray: add it, or leave this out")

    @property
    def share(self) -> "Share":
        """What each process gets."""
        from priors.scale.ray_session import Share

        return Share(self.cpus_per_worker, self.gpus_per_worker)

    @contextmanager
    def scorer(self) -> Iterator["RayScorer | None"]:
        """Give what scores on the cluster while the block runs; None: here."""
        if self.engine == "local":
            yield None
            return
        from priors.scale.ray_session import session
        from priors.scale.scoring import RayScorer

        with session(self.address) as ray:
            yield RayScorer(ray, self.share)

    @contextmanager
    def elsewhere(self) -> Iterator["FitElsewhere | None"]:
        """Give what fits a run's blocks on the cluster while the block runs; None: they are fitted here."""
        if self.engine == "local":
            yield None
            return
        from nerf.blocks_on_ray import RayBlocks
        from priors.scale.ray_session import session

        with session(self.address) as ray:
            yield RayBlocks(ray, self.share)
