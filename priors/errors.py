"""The errors a user is meant to read."""


class DataError(Exception):
    """Bad data, told in one line: what was expected, what was found, what to do.

    The command line prints it without a traceback and exits 1.
    """


class UsageError(DataError):
    """A command that was called wrongly; the command line exits 2."""
