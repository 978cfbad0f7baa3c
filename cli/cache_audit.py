"""`priors check cache/`: every map of a cache is read, and what is wrong is printed."""

from collections.abc import Iterable
from pathlib import Path

from cli.console import DATA_ERROR, err, out, progress
from priors import cache, drives
from priors.cache.audit import Audit, audit
from priors.cache.prior import Prior
from priors.errors import DataError
from priors.types import Drive

LISTED = 10
"""Frames of a kind that are named; the others are counted."""


def check_cache(path: Path) -> int:
    """Read all priors at path and print what was found; returns the exit code: 1 where something is damaged."""
    refused: list[DataError] = []
    priors = cache.find(path, refused.append)
    with progress("check", sum(len(prior.ids()) for prior in priors)) as step:
        audits = [audit(prior, _drive(prior), step) for prior in priors]
    for found in audits:
        _print(found)
    for error in refused:
        err.complain(error, "left out")
    counts = {
        "verified": sum(len(found.verified) for found in audits),
        "not verified": sum(len(found.unverified) for found in audits),
        "stale": sum(len(found.stale) for found in audits),
        "damaged": sum(len(found.damaged) for found in audits),
        "orphaned": sum(len(found.orphans) for found in audits),
    }
    out.print(", ".join(f"{count} {what}" for what, count in counts.items()))
    if counts["stale"] or counts["damaged"]:
        out.print("the `priors build` that made them makes stale and damaged maps anew, and no others")
    return DATA_ERROR if counts["damaged"] or refused else 0


def _drive(prior: Prior) -> Drive | None:
    """Open a prior's drive; None, and the reason is told, where it is not there or is another one now."""
    try:
        drive = drives.reopen(prior.drive)
        if drive.fingerprint() == prior.manifest.get("fingerprint", drive.fingerprint()):
            return drive
        why = f"{prior.drive['path']}: calibration, poses or first image differ"
    except DataError as error:
        why = str(error)
    err.print(f"{prior.folder}: not compared with its drive: {why}")
    return None


def _print(found: Audit) -> None:
    folder = found.prior.folder
    if not found.prior.ids():
        out.print(f"note     {folder}: no maps yet")
    if found.verified:
        out.print(f"ok       {folder}: {len(found.verified)} maps are what was written")
    if found.unverified:
        out.print(f"note     {folder}: {len(found.unverified)} maps have no checksum: readable, not verified")
    for level, reasons in (("stale", found.stale), ("damaged", found.damaged)):
        _list(f"{level:<9}{folder}:", [f"{id_}: {reason}" for id_, reason in reasons.items()])
    _list(f"orphan   {folder}:", found.orphans)


def _list(head: str, texts: Iterable[str]) -> None:
    texts = list(texts)
    for text in texts[:LISTED]:
        out.print(f"{head} {text}", soft_wrap=True)
    if len(texts) > LISTED:
        out.print(f"{head} and {len(texts) - LISTED} more")
