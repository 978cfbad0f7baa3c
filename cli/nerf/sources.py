"""Finds the drive and the prior of a fit, where the user names both, one of them, or none."""

import shlex
from collections.abc import Sequence
from pathlib import Path

from cli.arguments import DriveArguments, by_drive, find_priors, folders_to_name, reopen_drive
from cli.console import err
from nerf.guide import TRUTH, Guide
from nerf.study import NONE
from priors.cache import Prior
from priors.drives import poses_of
from priors.errors import DataError, UsageError
from priors.plan.choice import PriorAdvice, advise_prior
from priors.types import Drive

AUTO = Path("auto")
"""`--prior auto` is `--prior cache/`."""
CACHE = Path("cache")


def named_priors(paths: Sequence[Path]) -> tuple[str, ...]:
    """Return what a study's priors are called: their folders, truth and none; a folder of several counts as all."""
    own = (NONE, TRUTH.name)
    found = [[str(path)] if str(path) in own else [str(each.folder) for each in find_priors(path)] for path in paths]
    return tuple(name for several in found for name in several)


def open_sources(args: DriveArguments, prior: Path | None, typed: Sequence[str]) -> tuple[Drive, Guide | None]:
    """Open the drive and the prior of a fit, and say what was chosen where the user named neither.

    Args:
        args: where the drive is; without DATA it is the prior's, else the only one here or below.
        prior: a prior's folder, or one that holds several; truth: the drive's own maps; None: colours alone.
        typed: program, command and flags, to repeat where there is something to choose.

    Raises:
        UsageError: the cache holds priors of several drives and none is named: they are listed.
    """
    if prior is None:
        return args.open(typed), None
    if str(prior) == TRUTH.name:
        return args.open(typed), TRUTH
    priors = find_priors(CACHE if prior == AUTO else prior)
    if args.names_drive:
        drive = args.open()
        own = [one for one in priors if one.manifest.get("fingerprint") == drive.fingerprint()]
        return drive, _choose(own or priors, drive)
    priors = _with_poses(priors, args.part.poses)
    drives = by_drive(priors)
    if len(drives) > 1:
        raise UsageError(f"{prior}: priors of {len(drives)} drives: name one:{_listed(drives, typed)}")
    drive = reopen_drive(priors, args.part.truth)
    err.print(f"drive: {drive.name}, as its priors say")
    return drive, _choose(priors, drive)


def _with_poses(priors: Sequence[Prior], wanted: str) -> list[Prior]:
    """Return the priors that were made with these poses; 'auto' takes all, and UsageError names those there are."""
    fitting = [prior for prior in priors if wanted in ("auto", poses_of(prior.drive))]
    if not fitting:
        found = " and ".join(sorted({poses_of(prior.drive) for prior in priors}))
        told = f"the priors were made with {found} poses: leave it out, or build anew with it"
        raise UsageError(f"--poses {wanted}: {told}")
    return fitting


def _choose(priors: Sequence[Prior], drive: Drive) -> Prior:
    """Return the prior that suits a fit; where there are several, say which, why, and how to take another."""
    made = [one for one in priors if one.ids()]
    if not made:
        raise DataError(f"{priors[0].folder}: no maps yet: build it first (`priors build`)")
    if len(made) == 1:
        return made[0]
    advice = advise_prior(made, drive)
    err.print(f"prior: {advice.label}: {advice.reason}{_others(advice)}")
    return advice.prior


def _others(advice: PriorAdvice) -> str:
    """Say how to take another."""
    label, other = advice.others[0]
    return f"; another: --prior {shlex.quote(str(other.folder))} ({label})"


def _listed(drives: Sequence[Sequence[Prior]], typed: Sequence[str]) -> str:
    """Number the drives, each as the command that takes its priors."""
    lines = []
    for number, folder in enumerate(folders_to_name(drives), 1):
        words = list(typed)
        at = words.index("--prior") + 1 if "--prior" in words else len(words)
        words[at : at + 1] = [str(folder)]
        lines.append(f"\n  {number}. {shlex.join(words)}")
    return "".join(lines)
