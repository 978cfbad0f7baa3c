"""The processes that fit one field together: `torchrun --nproc-per-node N -m cli.nerf -- fit ...`.

Each process trains on its own rays of a batch; parameters stay equal in all, because each adds up the same gradients
in the same order. So N processes of r rays do what one does with N r: whatever looks at a whole batch asks here. The
order of the sums is that of the ranks: the same seed gives the same bits for the same N.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta

import torch
from torch import Tensor, distributed

from priors.errors import DataError

PATIENCE = timedelta(hours=2)
"""How long a process waits for the others: one alone prepares the scene."""


@dataclass(frozen=True)
class World:
    """Who takes part in a fit; a world of one asks nobody."""

    rank: int = 0
    size: int = 1

    @property
    def leads(self) -> bool:
        """Whether this process writes what all have in common."""
        return self.rank == 0

    def part(self, count: int) -> slice:
        """Return which of `count` rays a process, times `size`, are this process's."""
        return slice(self.rank * count, (self.rank + 1) * count)

    def total(self, values: Tensor) -> Tensor:
        """Add up all processes' values, in the order of their ranks."""
        if self.size == 1:
            return values
        pieces = self._gathered(values)
        whole = pieces[0].clone()
        for piece in pieces[1:]:
            whole += piece
        return whole

    def most(self, value: Tensor) -> Tensor:
        """Return the largest of all processes' values."""
        return value if self.size == 1 else torch.stack(self._gathered(value)).amax(0)

    def joined(self, values: Tensor) -> Tensor:
        """Put all processes' values (m, ...) behind each other; m may differ."""
        if self.size == 1:
            return values
        counts = self.counts(len(values))
        padded = values.new_zeros(max(counts), *values.shape[1:])
        padded[: len(values)] = values
        return torch.cat([piece[:count] for piece, count in zip(self._gathered(padded), counts, strict=True)])

    def counts(self, count: int) -> list[int]:
        """Return all processes' counts."""
        return [count] if self.size == 1 else [int(each) for each in self._gathered(torch.tensor(count))]

    def before(self, count: int) -> int:
        """Return how many there are in the processes of lower rank."""
        return sum(self.counts(count)[: self.rank])

    def leaders(self, value: float) -> float:
        """Return the first process's value: clocks differ, decisions must not."""
        return value if self.size == 1 else float(self._gathered(torch.tensor(value, dtype=torch.float64))[0])

    def wait(self) -> None:
        """Wait until all processes are here."""
        if self.size > 1:
            distributed.barrier()

    def _gathered(self, values: Tensor) -> list[Tensor]:
        own = values.detach().cpu().contiguous()
        pieces = [torch.empty_like(own) for _ in range(self.size)]
        distributed.all_gather(pieces, own)
        return [piece.to(values.device) for piece in pieces]


ALONE = World()


def here() -> World:
    """Return the world of this process."""
    if not distributed.is_available() or not distributed.is_initialized():
        return ALONE
    return World(distributed.get_rank(), distributed.get_world_size())


def add_up(parameters: Mapping[str, Tensor]) -> None:
    """Replace the gradients of parameters by their sums over all processes."""
    world = here()
    for tensor in parameters.values() if world.size > 1 else ():
        if tensor.grad is not None:
            tensor.grad.copy_(world.total(tensor.grad))


@contextmanager
def launched() -> Iterator[World]:
    """Meet the other processes of a launch by `torchrun` while the block runs; alone without one.

    Raises:
        DataError: the others are not found.
    """
    if int(os.environ.get("WORLD_SIZE", "1")) < 2 or "MASTER_ADDR" not in os.environ:
        yield here()
        return
    try:
        distributed.init_process_group("gloo", timeout=PATIENCE)
    except (RuntimeError, ValueError) as error:
        raise DataError(f"the other processes of this launch are not found ({error}): use torchrun") from error
    try:
        yield here()
    finally:
        distributed.destroy_process_group()


@contextmanager
def leader_first() -> Iterator[None]:
    """Let the first process do the block before the others: it writes files that they find then."""
    world = here()
    if not world.leads:
        world.wait()
    try:
        yield
    finally:
        if world.leads:
            world.wait()
