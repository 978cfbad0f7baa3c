"""The one error that a user can mend. Every other error is a bug of roadprior."""


class DataError(Exception):
    """Bad data, told in one line: what was expected, what was found, what to do.

    The command line prints it without a traceback and exits 1.
    """
