"""What to call priors in tables and pictures: the method and what is not usual about it."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from priors import methods
from priors.cache import Prior


def labels(priors: Sequence[Prior]) -> list[str]:
    """Name priors shortly, each differently: method, changed settings, filters, and the key where those are alike."""
    names = [label(prior) for prior in priors]
    often = Counter(names)
    return [
        name if often[name] == 1 else f"{name} [{prior.manifest['key'][:6]}]"
        for name, prior in zip(names, priors, strict=True)
    ]


def label(prior: Prior) -> str:
    """Name one prior: 'stereo', 'lidar sweeps=1', 'stereo + Clip 80'."""
    usual = _defaults(prior.method)
    config: dict[str, Any] = prior.manifest.get("config", {})
    settings = [f"{name}={value}" for name, value in config.items() if usual.get(name, value) not in (value, "auto")]
    filters = [_words(name, values) for name, values in prior.manifest.get("filters", {}).items()]
    return " + ".join([" ".join([prior.method, *settings]), *filters])


def _words(name: str, values: dict[str, Any]) -> str:
    shown = [f"{value:g}" for key, value in values.items() if key not in ("seed", "version")]
    return " ".join([name, *shown])


def _defaults(method: str) -> dict[str, Any]:
    """Return a method's usual settings; none for a method this version does not know."""
    if method not in methods.names():
        return {}
    defaults: dict[str, Any] = asdict(methods.config_type(method)())
    return defaults
