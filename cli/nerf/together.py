"""Several processes of one command (`torchrun`): only the first one prints, the others print their errors."""

from collections.abc import Iterator
from contextlib import contextmanager

from cli.terminal import err, out
from nerf.world import launched
from priors.errors import DataError


@contextmanager
def together() -> Iterator[None]:
    """Meet the other processes of a launch while the block runs, and let only the first one print."""
    with launched() as world:
        if world.leads:
            yield
            return
        out.quiet = err.quiet = True
        try:
            yield
        except DataError as error:
            raise DataError(f"process {world.rank} of {world.size}: {error}") from error
        finally:
            out.quiet = err.quiet = False
