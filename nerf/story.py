"""The whole story on one page: drives' priors, and the fields that were fitted with and without them."""

from collections.abc import Sequence
from dataclasses import replace

from nerf.page import FieldScores, fields_chapter, key_figures
from priors.report.page import Page
from priors.report.scores import DriveScores, priors_chapter
from priors.report.wipe import fit_into

VIDEO_SHARE = 0.6
"""Videos take at most this share of a page's room; larger ones stay files of their own."""


def story_page(fields: Sequence[FieldScores], priors: Sequence[DriveScores], command: str, room: int) -> Page:
    """Lay out the page of runs and, where any are given, of the priors that they lean on.

    Args:
        fields: the runs of each drive.
        priors: the priors of each drive.
        command: what made the page.
        room: how many bytes pictures and videos may take.

    Raises:
        ScoreError: the protocols of one drive's results differ.
    """
    fields, priors = fitting(fields, priors, room)
    drives = list(dict.fromkeys([*(each.drive for each in fields)]))
    chapters = [*(priors_chapter(each, None) for each in priors), *map(fields_chapter, fields)]
    what = "Depth priors and radiance fields" if priors else "Radiance fields"
    return Page(f"{what} of {', '.join(drives)}", _lead(fields), chapters, command)


def fitting(
    fields: Sequence[FieldScores], priors: Sequence[DriveScores], room: int
) -> tuple[list[FieldScores], list[DriveScores]]:
    """Leave out what a page has no room for: videos that are too large, then pictured frames, evenly."""
    videos = sum(path.stat().st_size * 4 // 3 for each in fields for _, path in each.video_files)
    shown = videos <= VIDEO_SHARE * room
    found = [each.wipe for each in priors if each.wipe is not None]
    found += [each.wipe for each in fields if each.wipe is not None]
    wipes = iter(fit_into(found, room - videos * shown))
    told = [each if each.wipe is None else replace(each, wipe=next(wipes)) for each in priors]
    return [replace(each, wipe=None if each.wipe is None else next(wipes), videos=shown) for each in fields], told


def _lead(fields: Sequence[FieldScores]) -> str:
    """Say what the prior brought, in one sentence."""
    for each in fields:
        found = key_figures(each)
        if found is not None and found.figures:
            figures = [(one.label.split(",")[0], f"{one.before} → {one.after} {one.unit}") for one in found.figures]
            changes = ", ".join(f"{label} {change}".strip() for label, change in figures)
            return f"What a depth prior brings to views that no training saw: {changes}."
    return "Fields fitted to a drive's images, scored on views that no training saw."
