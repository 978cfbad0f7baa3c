"""The baseline of a table: the warp of the same frames, untrained. The table tells where a field is worse than it."""

from collections.abc import Sequence

from nerf.report import Report

BASELINE = "warp"
"""The family that the others are compared with (nerf/fields/warp.py)."""


def unbeaten(names: Sequence[str], reports: Sequence[Report]) -> list[str]:
    """Say which runs have no better PSNR than the best warp of as many views, on the same held-out ones: 0 or 1 line.

    Args:
        names: what the runs are called, (n,).
        reports: theirs, (n,).
    """
    best: dict[tuple[object, ...], float] = {}
    for each in reports:
        if _choice(each, "field") == BASELINE:
            best[_task(each)] = max(best.get(_task(each), 0.0), each.metrics()["psnr"])
    below = [
        f"{name} ({psnr:.2f}, the warp {best[task]:.2f})"
        for name, each in zip(names, reports, strict=True)
        if _choice(each, "field") != BASELINE
        and (task := _task(each)) in best
        and not (psnr := each.metrics()["psnr"]) > best[task]
    ]
    return [f"no better than the warp of the same frames, which is not trained; PSNR: {', '.join(below)}"] * bool(below)


def _task(report: Report) -> tuple[object, ...]:
    """Return what must be equal for PSNRs to be compared."""
    return _choice(report, "views"), tuple(frame.frame for frame in report.frames)


def _choice(report: Report, name: str) -> object:
    """Return a run's field or views, from what `nerf fit` or a study wrote of it; None where it does not say."""
    config = report.info.get("config")
    if not isinstance(config, dict):
        return None
    spec = config.get("spec")
    if isinstance(spec, dict):
        return spec.get(name)
    if name == "field":
        fit = config.get("fit")
        return fit["model"].get("family") if isinstance(fit, dict) and isinstance(fit.get("model"), dict) else None
    return config.get(name)
