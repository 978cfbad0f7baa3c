"""What the two views share: their address, and how they end."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from cli.console import out
from priors.errors import expect
from priors.view import server


class Panel(Protocol):
    """The controls of a view, and the work behind them."""

    @property
    def fault(self) -> BaseException | None:
        """What ended the work, if anything did."""

    def close(self) -> None:
        """End the work."""


@dataclass(frozen=True)
class AddressArguments:
    """Where a view is served."""

    port: int | None = field(default=None, kw_only=True)
    """Port to listen on; default: the first free one from 8080 on."""
    host: str = field(default="localhost", kw_only=True)
    """Address to listen on; 0.0.0.0: every one of this machine, so that others in its network can look too."""

    def __post_init__(self) -> None:
        server.check_port(self.port)
        expect(self.host != "", "--host", "''", "an address, for example localhost")

    def serve(self, title: str, open_panel: Callable[[Any], Panel]) -> int:
        """Serve until Ctrl-C; returns the exit code.

        Args:
            title: of the panel in the browser.
            open_panel: puts the controls into viser's server.
        """
        with server.opened(self.host, self.port, title) as (opened, address):
            panel = open_panel(opened)
            out.print(f"open {address} in a browser; Ctrl-C ends the view", soft_wrap=True)
            try:
                server.wait(lambda: panel.fault)
            finally:
                panel.close()
        out.print("the view has ended")
        return 0
