"""The errors that a user reads: DataError, and UsageError where a command was called wrongly."""

from eval.errors import DataError as DataError


class UsageError(DataError):
    """A command that was called wrongly; the command line exits 2."""
