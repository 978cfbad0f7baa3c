"""The one error that a user reads; every other error is a fault of ours."""


class DataError(Exception):
    """Bad data, told in one line: what was expected, what was found, what to do.

    The command line prints it without a traceback and exits 1.
    """
