"""Findings of the study, each judged by what was measured: it reproduces, it does not and why, or it was not run.

A verdict is a rule on figures, written before any run; nothing here is filled in by hand.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from nerf.paper import numbers
from nerf.paper.measured import Measured
from nerf.paper.numbers import COMPLETION, FIELDS, MONO, NONE, STEREO, TABLE_3, TABLE_6, TRUTH
from nerf.paper.plan import DENSITIES, FEW_FIELD, FEW_VIEWS

Verdict = Literal["reproduces", "does not", "in part", "not run"]
SAME_DB = 0.3
"""Two PSNRs that are nearer than this count as the same: the study's own "no significant difference" is 0.2 dB."""
NEAR_DB = 0.6
"""What the study calls comparable: its mono is up to 0.4 dB below its true depth."""
LESS_ERROR = 0.3
"""Share of AbsRel that a prior takes at least, where the study says that geometry improves."""
PRIORS = (TRUTH, COMPLETION, STEREO, MONO)
OFF = 0.1
"""A field whose AbsRel is larger than this may have learned from a prior that is off, ..."""
WORSE = 1.3
"""... and has where it is so many times that of the field that learned from true depth."""


@dataclass(frozen=True)
class Finding:
    """A finding of the study, and what was measured of it."""

    says: str
    """What the study found, in a sentence, with its figures."""
    verdict: Verdict
    measured: str
    """The figures that decide it."""
    why: str = ""
    """Why it does not reproduce, as far as the figures tell."""


@dataclass(frozen=True)
class Test:
    """One case of a finding: what it says of one field or prior."""

    label: str
    holds: bool
    told: str


def judge(measured: Measured) -> list[Finding]:
    """Judge every finding of the study."""
    return [rule(measured) for rule in RULES]


def sparse_gains(measured: Measured) -> Finding:
    """Judge: any prior helps in sparse views."""
    tests = []
    for field in measured.plan.fields:
        alone, error = measured.psnr(NONE, field), measured.abs_rel(NONE, field)
        for role in PRIORS:
            psnr, abs_rel = measured.psnr(role, field), measured.abs_rel(role, field)
            if alone is None or psnr is None:
                continue
            study = _gain(field, role, "sparse")
            better = error is None or abs_rel is None or abs_rel < error
            told = f"{psnr - alone:+.2f} dB" + ("" if study is None else f" (study {study:+.2f})")
            tests.append(Test(f"{field} {role}", psnr > alone and better, told))
    says = "In sparse views every prior raises PSNR and lowers AbsRel: by 1.1 to 3.2 dB."
    return _finding(says, tests, lambda: _why_less(measured))


def mono_is_enough(measured: Measured) -> Finding:
    """Judge: mono is as good as true depth in sparse views."""
    tests = []
    for field in measured.plan.fields:
        alone, truth, mono = (measured.psnr(role, field) for role in (NONE, TRUTH, MONO))
        if alone is None or truth is None or mono is None:
            continue
        study = _difference(field, MONO, TRUTH)
        told = f"{mono - truth:+.2f} dB beside true depth" + ("" if study is None else f" (study {study:+.2f})")
        tests.append(Test(field, mono > truth - NEAR_DB and mono > alone, told))
    says = "Monocular depth is enough for sparse views: it comes within 0.4 dB of true depth."
    return _finding(says, tests, lambda: _off(measured, (MONO,)))


def dense_is_geometry(measured: Measured) -> Finding:
    """Judge: in dense views priors improve depth, and colours little."""
    tests = []
    for field in measured.plan.fields:
        alone, error = measured.psnr(NONE, field, "dense"), measured.abs_rel(NONE, field, "dense")
        for role in PRIORS:
            psnr, abs_rel = measured.psnr(role, field, "dense"), measured.abs_rel(role, field, "dense")
            if None in (alone, error, psnr, abs_rel):
                continue
            assert alone is not None and error is not None and psnr is not None and abs_rel is not None
            holds = abs(psnr - alone) <= 1 and abs_rel <= (1 - LESS_ERROR) * error
            tests.append(Test(f"{field} {role}", holds, f"{psnr - alone:+.2f} dB, AbsRel {error:.3f} to {abs_rel:.3f}"))
    says = "In dense views a prior takes at least 30 % of AbsRel, and changes PSNR by less than 1 dB."
    return _finding(says, tests, lambda: _off(measured, PRIORS[1:]))


def denser_is_better(measured: Measured, *, over_all: bool) -> Finding:
    """Judge: the more of a prior's values, the better."""
    rule = "all rays" if over_all else "the rays with a prior"
    tests = []
    for role in (MONO, COMPLETION, STEREO):
        few = measured.psnr(role, density=DENSITIES[0], over_all=over_all)
        whole = measured.psnr(role, over_all=over_all)
        if few is None or whole is None:
            continue
        told = f"{few:.2f} dB at {DENSITIES[0]:.0%}, {whole:.2f} with all"
        tests.append(Test(role, whole > few + SAME_DB, told))
    says = f"The denser the better (depth loss as the mean over {rule})."
    why = [] if over_all else ["with this mean a sparse map pulls as hard as a dense one"]
    return _finding(says, tests, lambda: "; ".join([*why, *filter(None, [_off(measured, PRIORS[1:])])]))


def little_is_enough(measured: Measured) -> Finding:
    """Judge: 5 % of the values improve sparse views."""
    alone, tests = measured.psnr(NONE), []
    for role in (MONO, COMPLETION, STEREO):
        few = measured.psnr(role, density=DENSITIES[0], over_all=True)
        if alone is not None and few is not None:
            tests.append(Test(role, few > alone, f"{few - alone:+.2f} dB beside colours alone"))
    return _finding(
        "A tiny amount of depth, 5 % of the pixels, improves sparse views.", tests, lambda: _off(measured, PRIORS[1:])
    )


def masked_mono(measured: Measured) -> Finding:
    """Judge: mono at the pixels of true depth is no better than true depth."""
    mono, masked, truth = (measured.psnr(MONO), measured.psnr(MONO, truth_mask=True), measured.psnr(TRUTH))
    tests = []
    if mono is not None and masked is not None and truth is not None:
        told = f"{mono:.2f} dB whole, {masked:.2f} masked, {truth:.2f} by true depth (study 17.97, 17.11, 17.47)"
        tests = [Test("mono", masked < mono and masked <= truth + SAME_DB, told)]
    says = "Mono that is masked to the pixels of true depth falls to true depth or below: its density is what helps."
    return _finding(says, tests, lambda: "")


def simple_losses(measured: Measured) -> Finding:
    """Judge: MSE and L1 are alike, KL is worse."""
    mse, l1, kl = (measured.psnr(MONO, loss=loss) for loss in ("mse", "l1", "kl"))
    tests = []
    if mse is not None and l1 is not None:
        tests.append(Test("l1 like mse", abs(l1 - mse) <= SAME_DB, f"{l1 - mse:+.2f} dB (study -0.06)"))
    if mse is not None and kl is not None:
        tests.append(Test("kl worse", kl < mse - SAME_DB, f"{kl - mse:+.2f} dB (study -1.42)"))
    why = "KL here has masses for targets and a standard deviation in metres; the study's mixes units (nerf/losses.py)"
    return _finding("MSE and L1 are alike; KL is significantly worse.", tests, lambda: why)


def filters_do_little(measured: Measured) -> Finding:
    """Judge: clipping and confidence change little."""
    tests = []
    pairs: list[tuple[str, str, dict[str, Any], float, float]] = [
        ("clip 80 m", MONO, {"clip": 80.0}, TABLE_6["mono, clip 80"].psnr - TABLE_6["mono"].psnr, SAME_DB),
        ("clip 40 m", MONO, {"clip": 40.0}, TABLE_6["mono, clip 40"].psnr - TABLE_6["mono"].psnr, NEAR_DB),
        ("confident", STEREO, {"confidence": 0.5}, TABLE_6["stereo, confident"].psnr - TABLE_6["stereo"].psnr, SAME_DB),
    ]
    for label, role, choice, study, most in pairs:
        whole, filtered = measured.psnr(role), measured.psnr(role, **choice)
        if whole is not None and filtered is not None:
            change = filtered - whole
            tests.append(Test(label, abs(change) <= most, f"{change:+.2f} dB (study {study:+.2f})"))
    return _finding("Clipping and filtering by confidence change little.", tests, lambda: "")


def few_views(measured: Measured) -> Finding:
    """Judge: priors help with very few views."""
    tests = []
    for views in FEW_VIEWS:
        alone = measured.psnr(NONE, FEW_FIELD, views)
        for role in (MONO, STEREO):
            psnr = measured.psnr(role, FEW_FIELD, views)
            if alone is None or psnr is None:
                continue
            study = numbers.FEW.get((views, role))
            beside = "" if study is None else f" (study {study[0] - numbers.FEW[views, NONE][0]:+.1f})"
            tests.append(Test(f"{views} {role}", psnr > alone, f"{psnr - alone:+.2f} dB{beside}"))
    return _finding("Depth helps with 1/8 and 1/16 of the views.", tests, lambda: _off(measured, (MONO,)))


RULES: Sequence[Callable[[Measured], Finding]] = (
    sparse_gains,
    mono_is_enough,
    dense_is_geometry,
    lambda measured: denser_is_better(measured, over_all=True),
    lambda measured: denser_is_better(measured, over_all=False),
    little_is_enough,
    masked_mono,
    simple_losses,
    filters_do_little,
    few_views,
)


def _finding(says: str, tests: Sequence[Test], why: Callable[[], str]) -> Finding:
    """Join the cases of a finding."""
    if not tests:
        return Finding(says, "not run", "no run of it has figures")
    held = sum(test.holds for test in tests)
    verdict: Verdict = "reproduces" if held == len(tests) else "does not" if held == 0 else "in part"
    told = "; ".join(f"{test.label} {test.told}{'' if test.holds else ' (!)'}" for test in tests)
    return Finding(says, verdict, told, "" if verdict == "reproduces" else why())


def _gain(field: str, role: str, views: str) -> float | None:
    """Return what a prior gains in the study, dB."""
    rows = [TABLE_3.get((field, own, views)) for own in (role, NONE)]
    return None if rows[0] is None or rows[1] is None else rows[0].psnr - rows[1].psnr


def _difference(field: str, role: str, other: str) -> float | None:
    """Return by how much one prior is better than another in the study's sparse views, dB."""
    rows = [TABLE_3.get((field, own, "sparse")) for own in (role, other)]
    return None if rows[0] is None or rows[1] is None else rows[0].psnr - rows[1].psnr


def _why_less(measured: Measured) -> str:
    """Say what the figures tell of a gain that is not there: colours alone are better here, or the prior is off."""
    reasons = []
    for field in measured.plan.fields:
        alone, row = measured.psnr(NONE, field), TABLE_3.get((field, NONE, "sparse"))
        if alone is not None and row is not None and alone > row.psnr + 1:
            reasons.append(f"{FIELDS[field]} by colours alone is {alone - row.psnr:.1f} dB better here than there")
    return "; ".join([*reasons, *filter(None, [_off(measured, (COMPLETION, STEREO, MONO))])])


def _off(measured: Measured, roles: Sequence[str]) -> str:
    """Say whose fields have a depth that shows that the prior is off: far worse than by true depth, at its best."""
    off = []
    for role in roles:
        errors = [measured.abs_rel(role, field) for field in measured.plan.fields]
        known = [error for error in errors if error is not None]
        truths = [error for field in measured.plan.fields if (error := measured.abs_rel(TRUTH, field)) is not None]
        if known and min(known) > max(OFF, WORSE * min(truths, default=0.0)):
            off.append(f"{role} is off: the fields that lean on it have an AbsRel of {min(known):.3f} and more")
    return "; ".join(off)
