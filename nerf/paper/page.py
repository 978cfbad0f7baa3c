"""Page of the study: its tables with what was measured beside what the study printed, and its findings, as Markdown.

<study>/study.md    written by `nerf study --preset paper`
"""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from eval.files import write_bytes
from nerf.paper import numbers
from nerf.paper.findings import Finding, judge
from nerf.paper.measured import Measured
from nerf.paper.numbers import FIELDS, MONO, NONE, ROLES, STEREO, TRUTH, Row
from nerf.paper.plan import CONFIDENT, DENSITIES, FEW_FIELD, FEW_VIEWS
from nerf.study import RunSpec
from nerf.study_table import prior_labels
from priors.machine import cpu

NAME = "study.md"
COLUMNS = ("PSNR", "SSIM", "LPIPS", "RMSE", "AbsRel")
DIGITS = Row(2, 3, 3, 3, 3)
LEAD = """\
The study is "Digging into Depth Priors for Outdoor Neural Radiance Fields" (Wang et al., ACM Multimedia 2023).
A cell has what was measured here and, behind the slash, what the study printed; a dash is a figure that is not
there. The study's figures are means of five KITTI sequences (of Argoverse: three logs) at full size, after 30
to 100 thousand steps on a GPU. Here it is one drive and far fewer steps: compare the differences between rows,
not the levels. SSIM is the Gaussian one of Instant-NGP and the uniform one of the others, as in the study."""
DENSITY_LEAD = """\
PSNR, dB, of MipNeRF-360 in sparse views by the share of a prior's values that is kept, drawn at random, under
both rules of averaging the depth loss: over the rays that have a prior, and over all rays, as the study does."""


def write(measured: Measured, folder: Path, command: str) -> Path:
    """Write the page into the study's folder."""
    path = folder / NAME
    write_bytes(path, page(measured, command).encode())
    return path


def page(measured: Measured, command: str) -> str:
    """Return the whole page."""
    runs = len(measured.plan.runs())
    parts = [
        "# The study, reproduced",
        LEAD.strip(),
        f"    {command}",
        f"{runs - len(measured.missing())} of {runs} runs have figures. {_basis(measured)}",
        "## Table 3",
        _table_3(measured),
        "## Few views",
        _few_views(measured),
        "## Table 6: ablations",
        f"MipNeRF-360, sparse views, seed {measured.plan.seeds[0]}; the study's are of one KITTI sequence.",
        _table_6(measured),
        "## Density",
        DENSITY_LEAD.strip(),
        _density(measured),
        "## Findings",
        "A verdict is a rule on the figures above (`nerf/paper/findings.py`); (!) marks the cases that do not hold.",
        _findings(judge(measured)),
        "## What was not run",
        _not_run(measured),
    ]
    return "\n\n".join(parts) + "\n"


def is_argoverse(measured: Measured) -> bool:
    """Tell whether the drive is of the study's second data set."""
    for outcome in measured.outcomes:
        config = {} if outcome.report is None else outcome.report.info.get("config", {})
        return isinstance(config, dict) and config.get("drive", {}).get("dataset") == "argoverse1"
    return False


def _basis(measured: Measured) -> str:
    """Say what the figures are of: drive, views, protocol, budget, seeds, priors."""
    made = next((each.report for each in measured.outcomes if each.report is not None), None)
    if made is None:
        return ""
    config = made.info.get("config", {})
    budget = f"{config['steps']} steps a run" if "steps" in config else f"{config.get('seconds', 0):g} s a run"
    name = Path(str(config.get("drive", {}).get("path", ""))).name
    frames = f", frames {config['frames']}" if config.get("frames") else ""
    labels = prior_labels([RunSpec("", "", prior) for prior in measured.plan.priors])
    priors = ", ".join(f"{ROLES.get(role, role)}: {labels[prior]}" for prior, role in measured.plan.roles.items())
    seeds = f"seeds {', '.join(map(str, measured.plan.seeds))} in table 3, the first of them elsewhere"
    scored = f"{len(made.frames)} held-out views, {made.protocol.describe()}"
    machine = f"CPU mode {cpu.mode()}; with steps for a budget, how busy the machine is changes no figure"
    return f"Drive {name}{frames}; {scored}; {budget}; {seeds}. Priors: {priors}. {machine}."


def _table_3(measured: Measured) -> str:
    printed = numbers.TABLE_5 if is_argoverse(measured) else numbers.TABLE_3
    heads = ["field", "prior", *(f"{views} {name}" for views in ("dense", "sparse") for name in COLUMNS), "± seeds dB"]
    rows = []
    for field in measured.plan.fields:
        for role in [role for role in ROLES if measured.plan.prior(role) is not None]:
            cells, spread = [], 0.0
            for views in ("dense", "sparse"):
                spec = measured.spec(role, field, views)
                cells += _cells(measured, spec, printed.get((field, role, views)))
                spread = max(spread, measured.spread_db(spec) if spec is not None else 0.0)
            told = f"{spread:.2f}" if len(measured.plan.seeds) > 1 else "-"
            rows.append([FIELDS.get(field, field), ROLES[role], *cells, told])
    return _markdown(heads, rows, lead=2)


def _few_views(measured: Measured) -> str:
    rows = []
    for views in FEW_VIEWS:
        for role in (NONE, MONO, STEREO):
            spec, study = measured.spec(role, FEW_FIELD, views), numbers.FEW.get((views, role))
            figures = measured.row(spec)
            beside = (None, None) if study is None else study
            cells = [_cell(figures["psnr"], beside[0], 2), _cell(figures["lpips"], beside[1], 3)]
            rows.append([views, ROLES[role], *cells, _cell(figures["abs_rel"], None, 3)])
    return _markdown(["views", "prior", "PSNR", "LPIPS", "AbsRel"], rows, lead=2)


def _table_6(measured: Measured) -> str:
    rows = [
        ("-", "RGB-Only", measured.spec(NONE), "none"),
        ("GT masking", "true depth", measured.spec(TRUTH), "truth"),
        ("GT masking", "mono, masked", measured.spec(MONO, truth_mask=True), "mono, masked"),
        ("GT masking", "mono", measured.spec(MONO), "mono"),
        ("clipping", "mono, 40 m", measured.spec(MONO, clip=40.0), "mono, clip 40"),
        ("clipping", "mono, 80 m", measured.spec(MONO, clip=80.0), "mono, clip 80"),
        ("confidence", "stereo", measured.spec(STEREO), "stereo"),
        ("confidence", f"stereo, {CONFIDENT:g}", measured.spec(STEREO, confidence=CONFIDENT), "stereo, confident"),
        ("loss", "mono, MSE", measured.spec(MONO), "mono"),
        ("loss", "mono, L1", measured.spec(MONO, loss="l1"), "mono, l1"),
        ("loss", "mono, KL", measured.spec(MONO, loss="kl"), "mono, kl"),
        ("loss", "mono, URF", measured.spec(MONO, loss="urf"), ""),
    ]  # fmt: skip
    made = [[kind, what, *_cells(measured, spec, numbers.TABLE_6.get(key))] for kind, what, spec, key in rows]
    return _markdown(["ablation", "", *COLUMNS], made, lead=2)


def _density(measured: Measured) -> str:
    shares = [*DENSITIES, None]
    heads = ["prior", "mean over", *("all" if share is None else f"{share:.0%}" for share in shares)]
    rows = []
    for role in (MONO, numbers.COMPLETION, STEREO, TRUTH):
        for over_all in (False, True):
            found = [measured.psnr(role, density=share, over_all=over_all) for share in shares]
            rows.append([ROLES[role], "all rays" if over_all else "rays with a prior", *(_write(x, 2) for x in found)])
    return _markdown(heads, rows, lead=2)


def _findings(found: Sequence[Finding]) -> str:
    lines = []
    for number, each in enumerate(found, 1):
        why = f" Why: {each.why}." if each.why else ""
        lines.append(f"{number}. {each.says} **{each.verdict.capitalize()}**: {each.measured}.{why}")
    return "\n".join(lines)


def _not_run(measured: Measured) -> str:
    """List what the plan has and nobody made, and what the plan could not have."""
    absent = [f"- {ROLES[role]}: no such prior was named." for role in ROLES if measured.plan.prior(role) is None]
    if not measured.plan.has_truth:
        absent.append("- GT masking: the drive has no true depth maps.")
    failed = {each.spec: each.error for each in measured.outcomes if each.report is None}
    absent += [f"- `{spec.name}`: {failed[spec]}." for spec in measured.missing() if spec in failed]
    kinds = Counter(_kind(spec) for spec in measured.missing() if spec not in failed)
    absent += [f"- {kind}: {count} run{'s' * (count > 1)} not made yet." for kind, count in kinds.items()]
    if not is_argoverse(measured):
        absent.append("- Table 5: no Argoverse log was at hand. The same command on a log writes it.")
    return "\n".join(absent) or "Everything was run."


def _kind(spec: RunSpec) -> str:
    """Say in which table a run stands."""
    if spec.views in FEW_VIEWS:
        return "Few views"
    if spec.density is not None or spec.over_all:
        return "Density"
    unusual = spec.loss not in (None, "mse") or spec.truth_mask or spec.clip is not None or spec.confidence is not None
    return "Table 6" if unusual else f"Table 3, {FIELDS.get(spec.field, spec.field)}, {spec.views}, seed {spec.seed}"


def _cells(measured: Measured, spec: RunSpec | None, study: Row | None) -> list[str]:
    """Write a row's figures beside the study's."""
    figures = measured.row(spec)
    beside = study._asdict() if study is not None else {}
    digits = DIGITS._asdict()
    return [_cell(figures[name], beside.get(name), int(digits[name])) for name in Row._fields]


def _cell(own: float | None, study: float | None, digits: int) -> str:
    return _write(own, digits) + ("" if study is None else f" / {_write(study, digits)}")


def _write(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _markdown(heads: Sequence[str], rows: Sequence[Sequence[str]], lead: int) -> str:
    rule = ["---"] * lead + ["---:"] * (len(heads) - lead)
    return "\n".join(f"| {' | '.join(line)} |" for line in [heads, rule, *rows])
