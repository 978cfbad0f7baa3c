"""The choice of a prior for a fit, among those that a drive has.

    advise_prior(priors, drive).prior    of the dense ones the one with the least error, or by the order of ORDER

`nerf fit --prior auto` follows it, and prints its reason.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from eval.protocol import ScoreError
from eval.result import Result
from priors.cache import Prior
from priors.errors import DataError
from priors.naming import labels
from priors.records import Record
from priors.selection import pick_middles
from priors.types import Drive, Mask

DENSE = 0.9
"""Share of the pixels that are no sky for which a prior must have a value, to be chosen before sparser ones."""
ORDER = ("stereo network", "classical stereo", "completion", "mono", "lidar")
"""Kinds of prior, the best first, where no scores tell more; a kind of your own comes last."""
MEASURED = 3
"""Frames on which a prior's share of the ground is measured."""


@dataclass(frozen=True)
class PriorAdvice:
    """The prior of a drive that suits a fit."""

    prior: Prior
    label: str
    """What tables call it, among its drive's priors."""
    reason: str
    """Why, in one line."""
    others: tuple[tuple[str, Prior], ...]
    """The other priors with their labels."""


def advise_prior(priors: Sequence[Prior], drive: Drive, ids: Sequence[str] | None = None) -> PriorAdvice:
    """Choose one of the priors of a drive for a fit.

    Of those with a value for DENSE of the pixels that are no sky, it is the one with the least AbsRel where all of
    them are scored by one protocol on the same frames; else the first in ORDER. Where none is so dense, it is the
    densest.

    Args:
        priors: the drive's, one or more; the drive's reader finds their images.
        drive: of all the priors.
        ids: the frames that count; default: those with a map of any prior.
    """
    names = labels(priors)
    if len(priors) == 1:
        return PriorAdvice(priors[0], names[0], "it is the only prior of the drive", ())
    shares = _ground_shares(priors, drive, ids)
    dense = [i for i, share in enumerate(shares) if share >= DENSE]
    if not dense:
        best = max(range(len(priors)), key=lambda i: (shares[i], -_place(priors[i])))
        reason = f"it covers the most, {shares[best]:.0%} of the pixels that are not sky"
    elif len(dense) == 1:
        best, reason = dense[0], f"no other covers {DENSE:.0%} of the pixels that are not sky"
    else:
        best, reason = _best_of(priors, shares, dense)
    others = tuple((name, prior) for i, (name, prior) in enumerate(zip(names, priors, strict=True)) if i != best)
    return PriorAdvice(priors[best], names[best], reason, others)


def kind(prior: Prior) -> str:
    """Return which of ORDER a prior is; its method's name where it is none of them."""
    if prior.method != "stereo":
        return prior.method
    config: Record = prior.manifest.get("config", {})
    return "classical stereo" if config.get("model", "classical") == "classical" else "stereo network"


def _best_of(priors: Sequence[Prior], shares: Sequence[float], dense: Sequence[int]) -> tuple[int, str]:
    """Choose among dense priors: the least AbsRel where they compare, else the first in ORDER; say why."""
    covering = f"of the {len(dense)} that cover {DENSE:.0%} of the pixels that are not sky"
    results = [_score(priors[i]) for i in dense]
    scored = [result for result in results if result is not None]
    if len(scored) == len(dense) and len({_compared(result) for result in scored}) == 1:
        errors = [result.metrics()["abs_rel"] for result in scored]
        if np.isfinite(errors).all():
            least = min(range(len(dense)), key=lambda i: (errors[i], _place(priors[dense[i]])))
            return dense[least], f"it has the least AbsRel, {errors[least]:.4f}, {covering}"
    best = min(dense, key=lambda i: (_place(priors[i]), -shares[i], priors[i].name))
    return best, f"{kind(priors[best])} comes first {covering} (not all are scored alike: `priors eval` compares them)"


def _score(prior: Prior) -> Result | None:
    """Read what `priors eval` has kept; None where there is nothing, or nothing that can be read."""
    try:
        return Result.load(prior.folder / "metrics.json")
    except ScoreError:
        return None


def _compared(result: Result) -> tuple[object, ...]:
    """Return what must be equal for two scores to compare."""
    return result.protocol, frozenset(row.frame for row in result.rows)


def _place(prior: Prior) -> int:
    """Return a prior's place in ORDER."""
    name = kind(prior)
    return ORDER.index(name) if name in ORDER else len(ORDER)


def _ground_shares(priors: Sequence[Prior], drive: Drive, ids: Sequence[str] | None) -> list[float]:
    """Return each prior's share of the pixels that are no sky, over the frames that count.

    A frame without a map has none. Where the images cannot be read, the recorded density of the maps stands for it.
    """
    mapped = [set(prior.ids()) for prior in priors]
    counted = [id_ for id_ in drive.ids if id_ in set().union(*mapped) and (ids is None or id_ in set(ids))]
    skies = _skies(drive, counted)
    shares = []
    for prior, own in zip(priors, mapped, strict=True):
        done = sum(id_ in own for id_ in counted) / max(1, len(counted))
        seen = [share for id_, sky in skies.items() if id_ in own and (share := _seen(prior, id_, sky)) is not None]
        shares.append(done * (float(np.mean(seen)) if seen else _recorded(prior)))
    return shares


def _skies(drive: Drive, ids: Sequence[str]) -> dict[str, Mask]:
    """Find the sky (height, width) in some frames, by id; frames that cannot be read are left out."""
    from priors.sky import sky_mask

    skies = {}
    places = {id_: index for index, id_ in enumerate(drive.ids)}
    for id_ in pick_middles(ids, MEASURED) if ids else []:
        try:
            skies[id_] = sky_mask(drive[places[id_]].image())
        except DataError:
            continue
    return skies


def _seen(prior: Prior, id_: str, sky: Mask) -> float | None:
    """Return for which share of the pixels that are no sky a map has a value; None where it cannot be read."""
    try:
        valid = prior.read(id_).valid
    except DataError:
        return None
    return float(valid[~sky].mean()) if valid.shape == sky.shape and not sky.all() else None


def _recorded(prior: Prior) -> float:
    """Return the mean density that a build has recorded; 0 where it has not."""
    densities = prior.figures("density")
    return float(np.mean(densities)) if densities else 0.0
