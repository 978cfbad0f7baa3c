"""--verbose and --debug, which every command takes: what goes on inside, by the standard library's logging.

Our modules log under their own names (`priors.build.work`, `nerf.keeper`): a program of your own configures `logging`
as it likes. Here the lines go to stderr, above a progress bar.
"""

import logging
import traceback
from collections.abc import Sequence

from rich.logging import RichHandler

from cli.terminal import err

VERBOSE, DEBUG = "--verbose", "--debug"
PACKAGES = ("priors", "nerf", "eval", "cli")


def taken(arguments: Sequence[str]) -> list[str]:
    """Set up what the two flags ask for, wherever they stand, and return the other arguments."""
    if DEBUG in arguments:
        _tell(logging.DEBUG)
    elif VERBOSE in arguments:
        _tell(logging.INFO)
    return [word for word in arguments if word not in (VERBOSE, DEBUG)]


def explain_error() -> None:
    """Print the traceback of the error that is being handled, where --debug asks for it."""
    if logging.getLogger(PACKAGES[0]).isEnabledFor(logging.DEBUG):
        err.write(traceback.format_exc())


def _tell(level: int) -> None:
    """Let our packages' loggers print from a level on; other packages' keep theirs."""
    handler = RichHandler(console=err, show_path=False, omit_repeated_times=False, log_time_format="%H:%M:%S")
    handler.setFormatter(logging.Formatter("%(name)s: %(message)s"))
    for name in PACKAGES:
        logger = logging.getLogger(name)
        logger.setLevel(level)
        logger.handlers = [handler]
