"""Server: viser behind an address. Everything that depends on how viser starts, talks and stops is here."""

import contextlib
import errno
import io
import socket
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any

from priors.errors import DataError, UsageError

PORT = 8080
"""Where the search for a free port begins."""
TRIED = 100
"""How many ports are tried."""
LARGEST_PORT = 65535
POLL_S = 0.25


def check_port(port: int | None) -> None:
    """Refuse a port that cannot be; UsageError."""
    if port is not None and not 0 <= port <= LARGEST_PORT:
        raise UsageError(f"--port {port}: expected 0 (any free one) to {LARGEST_PORT}")


def require() -> Any:
    """Import viser, or say how to install it."""
    try:
        return import_module("viser")
    except ImportError as error:
        raise DataError(f"a live view needs viser ({error}): pip install 'roadprior[view]'") from error


def free_port(host: str, port: int | None) -> int:
    """Return the port to listen on: the given one, else the first free one from PORT on.

    Raises:
        DataError: the given one is taken or may not be used, or no port is free.
        UsageError: the host is not this machine.
    """
    if port is not None:
        if (refusal := _refusal(host, port)) is not None:
            raise DataError(f"--port {port}: {refusal}: choose another, or leave --port out for the first free one")
        return port
    for candidate in range(PORT, PORT + TRIED):
        if _refusal(host, candidate) is None:
            return candidate
    raise DataError(f"no free port from {PORT} to {PORT + TRIED - 1}: name one by --port")


def _refusal(host: str, port: int) -> str | None:
    """Say why a port cannot be listened on; None where it can. DataError where the host is the fault."""
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(
            _bound(host), port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except (OSError, UnicodeError) as error:
        raise UsageError(f"--host {host}: no such host: leave it out, or name this machine's address") from error
    with socket.socket(family, kind, protocol) as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind(place)
            tried.listen(1)
        except PermissionError:
            return "ports below 1024 need rights that this user lacks"
        except OSError as error:
            if error.errno in _NOT_OURS:
                raise UsageError(f"--host {host}: not an address of this machine: leave it out") from error
            return "in use by another program"
    return None


_NOT_OURS = (errno.EADDRNOTAVAIL, errno.EAFNOSUPPORT)


def _bound(host: str) -> str:
    """Return what is bound: by its name, localhost may mean an IPv6 address that containers lack."""
    return "127.0.0.1" if host == "localhost" else host


@contextlib.contextmanager
def opened(host: str, port: int | None, title: str) -> Iterator[tuple[Any, str]]:
    """Serve inside; yields viser's server and the address to open.

    Raises:
        DataError: viser is not installed, or the port or the host cannot be used.
    """
    viser = require()
    chosen = free_port(host, port)
    with _silent():
        server = viser.ViserServer(_bound(host), chosen, label=title, verbose=False)
    try:
        server.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=True)
        yield server, f"http://{_shown(host)}:{server.get_port()}"
    finally:
        with _silent():
            server.stop()


def _shown(host: str) -> str:
    """Return the host as an address that a browser opens."""
    if host in ("0.0.0.0", "::", ""):
        return socket.gethostname()
    return f"[{host}]" if ":" in host else host


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Keep viser from printing: the commands say in one line where to look."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


def wait(fault: Callable[[], BaseException | None]) -> None:
    """Wait for Ctrl-C, and return then; raises what ended the work behind the view, should anything."""
    try:
        while (found := fault()) is None:
            time.sleep(POLL_S)
    except KeyboardInterrupt:
        return
    raise found
