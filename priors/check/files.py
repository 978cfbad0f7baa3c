"""Files: can everything be read, and has it the calibration's size?"""

from collections.abc import Iterator, Sequence
from typing import get_args

from priors.check.finding import Finding
from priors.check.sample import Sample
from priors.types import Input

WHAT: tuple[Input, ...] = tuple(what for what in get_args(Input) if what not in ("sky", "foreground"))


def judge_files(sampled: Sequence[Sample]) -> Iterator[Finding]:
    """Say of each kind of file how many of the sampled frames have it, and what cannot be read."""
    for what in WHAT:
        having = [sample for sample in sampled if sample.frame.has(what)]
        if not having:
            reason = sampled[0].frame.missing.get(what, "the drive has none")
            yield Finding("note", "files", f"no {what}: {reason}")
            continue
        errors = [error for sample in having if (error := sample.error(what)) is not None]
        read = sum(sample.read(what) is not None for sample in having)
        if errors:
            text = f"{what}: {len(errors)} of {len(having)} sampled cannot be read, the first: {errors[0]}"
            yield Finding("fatal", "files", text)
        elif read:
            yield Finding("ok", "files", f"{what}: {read} of {len(sampled)} sampled frames read")
        else:
            yield Finding("warning", "files", f"{what}: none of the {len(having)} sampled frames has one")
