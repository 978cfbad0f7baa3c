"""What to call priors in tables and pictures: the method and what is not usual about it."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

from priors import methods
from priors.cache import Prior
from priors.records import Record, record, upgrade


def labels(priors: Sequence[Prior], long: bool = False) -> list[str]:
    """Name the priors of a table, each differently.

    A name is short: the method and its network ('stereo cfnet'), then what differs between priors of that name, and
    the key only where nothing else does. A long one tells every unusual setting: 'stereo model=cfnet + Clip 80'.
    """
    names = [_long_name(prior) for prior in priors] if long else _short_names(priors)
    often = Counter(names)
    return [name if often[name] == 1 else _with_key(name, prior) for name, prior in zip(names, priors, strict=True)]


def _short_names(priors: Sequence[Prior]) -> list[str]:
    """Name each prior by its method, its network, and what differs between those that share both."""
    names = [_network_name(prior) for prior in priors]
    described = [_described(prior) for prior in priors]
    short = []
    for name, own in zip(names, described, strict=True):
        alike = [other for other_name, other in zip(names, described, strict=True) if other_name == name]
        differing = [text for key, text in own.items() if any(other.get(key) != text for other in alike)]
        short.append(" ".join([name, *differing]))
    return short


def _network_name(prior: Prior) -> str:
    """Return 'stereo cfnet', 'imported depths_mono', or the method's name alone where its usual model made the maps."""
    source = prior.manifest.get("source")
    if isinstance(source, str):
        return f"{prior.method} {source}"
    usual, own = _usual_and_own(prior)
    model = own.get("model")
    return prior.method if model is None or model == usual.get("model") else f"{prior.method} {model}"


def _long_name(prior: Prior) -> str:
    """Name a prior by its method and everything that is unusual about it."""
    return " ".join([prior.method, *_described(prior).values()])


def _described(prior: Prior) -> dict[str, str]:
    """Return what is unusual about a prior, in words, by setting and filter."""
    usual, own = map(_flat, _usual_and_own(prior))
    words = {key: f"{key}={_short(value)}" for key, value in own.items() if usual.get(key, value) != value}
    reuse = prior.manifest.get("reuse")
    if isinstance(reuse, dict):
        words["reuse"] = f"reuse={reuse.get('frames')}"
    filters = prior.manifest.get("filters", {})
    return words | {name: f"+ {_words(name, values)}" for name, values in filters.items()}


def _with_key(name: str, prior: Prior) -> str:
    return f"{name} [{prior.manifest['key'][:6]}]"


def _short(value: Any) -> str:
    if isinstance(value, list | tuple):
        return ",".join(map(_short, value))
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _words(name: str, values: dict[str, Any]) -> str:
    shown = [f"{value:g}" for key, value in values.items() if key not in ("seed", "version")]
    return " ".join([name, *shown])


def _flat(settings: Record) -> Record:
    """Return settings with those of nested configs beside the others: {"stereo.model": "cfnet"}."""
    flat: Record = {}
    for key, value in settings.items():
        nested = _flat(value) if isinstance(value, dict) else None
        flat |= {key: value} if nested is None else {f"{key}.{name}": inner for name, inner in nested.items()}
    return flat


def _usual_and_own(prior: Prior) -> tuple[Record, Record]:
    """Return a method's usual settings and a prior's, in today's names; no usual ones where the method is not known."""
    own: Record = prior.manifest.get("config", {})
    if "source" in prior.manifest:
        return dict.fromkeys(own), own  # imported: whatever differs between two is told
    if prior.method not in methods.names():
        return {}, own
    kind = methods.config_type(prior.method)
    return record(kind()), upgrade(kind, own)
