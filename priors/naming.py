"""What to call priors in tables and pictures: the method and what is not usual about it."""

from collections import Counter
from collections.abc import Sequence
from functools import partial
from typing import Any

from priors import methods
from priors.cache import Prior
from priors.records import Record, record, upgrade


def labels(priors: Sequence[Prior]) -> list[str]:
    """Name priors shortly, each differently: what was decided for the drive, and the key, only where it is needed."""
    names = [label(prior) for prior in priors]
    for longer in (partial(label, decided=True), _with_key):
        often = Counter(names)
        names = [name if often[name] == 1 else longer(prior) for name, prior in zip(names, priors, strict=True)]
    return names


def label(prior: Prior, decided: bool = False) -> str:
    """Name one prior: 'stereo', 'lidar sweeps=1', 'stereo + Clip 80'.

    Settings that are 'auto' by default and were decided for the drive are named where `decided` is True.
    """
    usual, config = _usual_and_own(prior)
    settings = [
        f"{name}={_short(value)}"
        for name, value in config.items()
        if usual.get(name, value) != value and (decided or usual[name] != "auto")
    ]
    filters = [_words(name, values) for name, values in prior.manifest.get("filters", {}).items()]
    return " + ".join([" ".join([prior.method, *settings]), *filters])


def _with_key(prior: Prior) -> str:
    return f"{label(prior)} [{prior.manifest['key'][:6]}]"


def _short(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ",".join(map(_short, value))
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _words(name: str, values: dict[str, Any]) -> str:
    shown = [f"{value:g}" for key, value in values.items() if key not in ("seed", "version")]
    return " ".join([name, *shown])


def _usual_and_own(prior: Prior) -> tuple[Record, Record]:
    """Return a method's usual settings and a prior's, in today's names; no usual ones where the method is not known."""
    own: Record = prior.manifest.get("config", {})
    if prior.method not in methods.names():
        return {}, own
    kind = methods.config_type(prior.method)
    return record(kind()), upgrade(kind, own)
