"""A Ray cluster to work on: one that runs already, or one of this machine's cores that ends with the command."""

import logging
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import ModuleType
from typing import Any

from priors import extensions
from priors.errors import DataError, expect
from priors.machine import cpu

PASSED_ON = (extensions.VARIABLE, cpu.VARIABLE, "ROADPRIOR_CACHE", "OMP_WAIT_POLICY", "OPENBLAS_NUM_THREADS")
"""Variables of the environment that the cluster's processes are given."""
QUIET = {"RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0", "RAY_BACKEND_LOG_LEVEL": "fatal", "RAY_DEDUP_LOGS": "1"}
"""What keeps Ray from telling what a user cannot act on; it reads them when it is imported."""
AUTO, NO_CLUSTER, PATIENCE_S = "auto", "no cluster there: `ray start --head` begins one", 10.0
STORE_BYTES = 100 * 2**20
"""Ray's object store where we start it: what travels are frames' numbers, never images."""


@dataclass(frozen=True)
class Share:
    """What each process of a cluster gets."""

    cpus: int = 2
    """Cores."""
    gpus: float = 0.0
    """GPUs; 0.5: two processes share one."""

    def __post_init__(self) -> None:
        expect(self.cpus >= 1, "--cpus-per-worker", self.cpus, "1 core or more")
        expect(0 <= self.gpus < float("inf"), "--gpus-per-worker", self.gpus, "0 or more")

    @property
    def options(self) -> dict[str, float]:
        """As Ray's tasks and actors take it."""
        return {"num_cpus": self.cpus, "num_gpus": self.gpus}


def import_ray() -> ModuleType:
    """Import Ray; DataError where it is not installed."""
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)
    try:
        import ray
    except ImportError as error:
        raise DataError("--engine ray: Ray is not installed: pip install 'roadprior[cluster]'") from error
    logging.getLogger("ray").setLevel(logging.ERROR)
    found: ModuleType = ray
    return found


@contextmanager
def session(address: str | None) -> Iterator[ModuleType]:
    """Connect to a cluster while the block runs; gives the module `ray`.

    Args:
        address: as Ray has it: auto, HOST:PORT or ray://HOST:PORT; None: a cluster of this machine alone.

    Raises:
        DataError: Ray is not installed, or there is no cluster at the address.
    """
    ray = import_ray()
    mine = not ray.is_initialized()
    if mine:
        _connect(ray, address)
    try:
        yield ray
    finally:
        if mine:
            ray.shutdown()


def slots(ray: ModuleType, share: Share) -> int:
    """Return how many processes of a share the cluster's living nodes hold at once.

    Raises:
        DataError: no node is large enough for one.
    """
    count = sum(_fit(node["Resources"], share) for node in ray.nodes() if node["Alive"])
    if count < 1:
        largest = max((node["Resources"].get("CPU", 0) for node in ray.nodes() if node["Alive"]), default=0)
        wanted = f"{share.cpus} cores" + (f" and {share.gpus:g} GPU" if share.gpus else "")
        raise DataError(
            f"no node has {wanted} for a process (the largest has {largest:g} cores): "
            "lower --cpus-per-worker or --gpus-per-worker"
        )
    return count


def _fit(resources: dict[str, float], share: Share) -> int:
    by_cpu = int(resources.get("CPU", 0) // share.cpus)
    return min(by_cpu, int(resources.get("GPU", 0) // share.gpus)) if share.gpus else by_cpu


def _expect_answer(address: str) -> None:
    """Raise where nothing listens at an address: Ray itself waits for minutes, and tells of each of its tries.

    Raises:
        UsageError: it is no address.
        DataError: nothing listens there.
    """
    host, _, port = address.removeprefix("ray://").rpartition(":")
    expect(bool(host) and port.isdigit(), "--address", address, "auto, HOST:PORT or ray://HOST:PORT")
    try:
        socket.create_connection((host.strip("[]"), int(port)), PATIENCE_S).close()
    except (OSError, OverflowError) as error:
        raise DataError(f"--address {address}: {NO_CLUSTER} ({error})") from error


def _connect(ray: ModuleType, address: str | None) -> None:
    if address not in (None, AUTO):
        _expect_answer(str(address))
    given: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
    if address is None:  # its processes are of this one's environment; to name it would start others beside them
        given |= {"include_dashboard": False, "object_store_memory": STORE_BYTES}
    else:
        passed = {name: os.environ[name] for name in PASSED_ON if name in os.environ}
        given["runtime_env"] = {"env_vars": passed}
    try:
        ray.init(address=address or "local", configure_logging=True, **given)
    except Exception as error:  # Ray raises plain ones too
        if address is None:
            raise DataError(f"--engine ray: Ray does not start here: {_first_line(error)}") from error
        raise DataError(f"--address {address}: {NO_CLUSTER}") from error


def _first_line(error: Exception) -> str:
    return next((line for line in str(error).splitlines() if line.strip()), type(error).__name__)
