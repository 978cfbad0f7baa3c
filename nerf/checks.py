"""Validation of settings: one line that names the setting, its value and what was expected."""

from priors.errors import DataError


def expect(holds: bool, name: str, value: object, expected: str) -> None:
    """Raise DataError unless it holds."""
    if not holds:
        raise DataError(f"{name} {value}: expected {expected}")
