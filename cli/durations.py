"""Durations as users type and read them: 90s, 5m, 1h."""

from priors.errors import UsageError, expect

UNITS_S = {"s": 1.0, "m": 60.0, "h": 3600.0}
MOST_S = 365 * 24 * 3600.0


def seconds(text: str, flag: str = "--time") -> float:
    """Turn 90s, 5m or 1h into seconds; `flag` is named where it cannot be done."""
    try:
        value = float(text[:-1]) * UNITS_S[text[-1]] if text[-1:] in UNITS_S else float(text)
    except ValueError as error:
        raise UsageError(f"{flag} {text or repr(text)}: expected a number and s, m or h, for example 60s") from error
    expect(0 < value <= MOST_S, flag, text, "more than 0, and less than a year")
    return value


def duration(seconds: float) -> str:
    """Write seconds as a reader takes them in: 40 s, 2.5 min, 1.2 h."""
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 3600:.1f} h" if seconds >= 5400 else f"{seconds / 60:.1f} min"
