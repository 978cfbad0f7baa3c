"""What was measured, as a page that a person reads."""

from typing import Any

from tests.bench.gpu.parts import find


def markdown(record: dict[str, Any]) -> str:
    """Return the page of a record; parts that still run, were cut or failed say so."""
    machine = record["parts"].get("machine", {}).get("figures", {})
    name = machine.get("device", record["device"])
    commit = record["commit"] or "unknown"
    lines = [f"# {name}", "", f"{record['began']}, commit {commit}, budget {record['budget_s']:.0f} s", ""]
    if record["device"] == "cpu":
        lines += ["A rehearsal without a GPU: none of these figures says anything about one.", ""]
    for part, entry in record["parts"].items():
        lines += [f"## {find(part).title}", "", _state(entry), ""]
        lines += _figures(entry["figures"])
        if entry.get("error"):
            lines += ["", *(f"    {line}" for line in entry["error"])]
        lines.append("")
    return "\n".join(lines)


def _state(entry: dict[str, Any]) -> str:
    """Say in a sentence how a part ended."""
    spent, allowed = entry.get("seconds", 0.0), entry["budget_s"]
    return {
        "done": f"Done in {spent:.1f} s.",
        "cut": f"**Cut**: it ran over its {allowed:.0f} s. What it had by then:",
        "failed": f"**Failed** after {spent:.1f} s. What it had by then, and its last lines:",
        "left out": "**Left out.**",
        "running": "Still running, or ended together with the run.",
    }[entry["state"]]


def _figures(figures: dict[str, Any]) -> list[str]:
    """Write single values as a list, and what has the same keys as a table with a row each."""
    rows = {
        key: value for key, value in figures.items() if isinstance(value, dict) and key not in ("modules", "failed")
    }
    lines = [f"- {key}: {_text(value)}" for key, value in figures.items() if key not in rows]
    columns = list(dict.fromkeys(column for row in rows.values() for column in row))
    if not columns:
        return lines
    lines += ["", "| | " + " | ".join(columns) + " |", "|---|" + "---:|" * len(columns)]
    return lines + [
        f"| {key} | " + " | ".join(_text(row.get(c, "")) for c in columns) + " |" for key, row in rows.items()
    ]


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {'missing' if item is None else item}" for key, item in value.items()) or "none"
    return str(value).replace("|", "/")
