"""Standard output and standard error of a command. Text is printed as it is: square brackets in names are no markup."""

import os
import sys
from typing import Any, TextIO

from rich.console import Console
from rich.text import Text

PIPE_WIDTH = 160


class Screen(Console):
    """A stream that prints what it is given, to whom still reads it."""

    def __init__(self, **options: Any) -> None:
        """Take rich's options; markup, emoji and highlighting are off."""
        super().__init__(markup=False, highlight=False, emoji=False, **options)

    @property
    def moves(self) -> bool:
        """Whether lines can be drawn over: on a terminal that is not dumb."""
        return self.is_terminal and not self.is_dumb_terminal

    def write(self, text: str) -> None:
        """Print text that has its lines already."""
        self.print(text, end="", soft_wrap=True)

    def complain(self, message: object, about: object = "error") -> None:
        """Print a line that begins, in red, with what it is about."""
        self.print(Text.assemble((f"{about}:", "bold red"), f" {message}"), soft_wrap=True)

    def on_broken_pipe(self) -> None:
        """Go on without a reader (`priors eval --save table.md | head -1`): what is written to files still is."""
        self.quiet = True
        silence(self.file)


def silence(stream: Any) -> None:
    """Let a stream of the process write to nowhere, so that nothing fails when it is closed."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def _is_terminal(stream: TextIO | None) -> bool:
    return stream is not None and stream.isatty()


out = Screen(width=None if _is_terminal(sys.stdout) else PIPE_WIDTH)
err = Screen(stderr=True, soft_wrap=True)
