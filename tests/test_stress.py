"""The stress table: every cell is right, and what is wrong would be seen."""

import json
import math
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cli.priors import PROGRAM
from cli.priors import stress as command
from priors.errors import DataError, UsageError
from priors.nets.tensors import as_bits
from priors.stress import page, tolerances
from priors.stress.inputs import INPUTS, USUAL, Given
from priors.stress.measure import measure
from priors.stress.precision import BF16, FP16, FP32, PRECISIONS
from priors.stress.routine import Case, Gradient, Routine, named
from priors.stress.routines import ROUTINES
from priors.stress.table import Table, cell, run

pytestmark = pytest.mark.stress
X = np.array([1.0, -2.0, 3.0])
RANDOM = np.random.default_rng(0)


@pytest.mark.parametrize("routine", ROUTINES, ids=lambda routine: routine.name)
def test_no_cell_of_the_table_fails(routine: Routine) -> None:
    table = run([routine], INPUTS)
    assert table.failures == []
    assert any(each.verdict == "ok" for each in table.cells)


def test_what_makes_no_sense_is_said_of_inputs_that_there_are() -> None:
    names = {each.name for each in INPUTS}
    for routine in ROUTINES:
        assert set(routine.senseless) <= names, routine.name
        assert all([*routine.senseless.values(), *routine.other_types.values()]), routine.name
    assert len({routine.name for routine in ROUTINES}) == len(ROUTINES)


def checked(found: object, wanted: object, **more: object) -> float:
    value = measure(Case(lambda: {"a": found}, lambda: {"a": wanted}, **more), RANDOM).value  # type: ignore[arg-type]
    assert value is not None
    return value


def test_an_error_is_a_share_of_the_natural_scale() -> None:
    off = X * [1, 1, 1.001]
    assert checked(off, X) == pytest.approx(1e-3)
    assert checked(off, X, scale={"a": 30}) == pytest.approx(1e-4)
    assert checked(X[:2], X) == math.inf
    assert checked(np.float32([1e-41]), np.array([1e-41])) < 1e-5, "a denormal has fewer digits"


@pytest.mark.parametrize(
    ("found", "wanted", "right"),
    [
        (np.nan, np.nan, True),
        (0.0, np.nan, False),
        (np.nan, 0.0, False),
        (np.inf, np.inf, True),
        (-np.inf, np.inf, False),
        (3e38, np.inf, False),
        (np.float32(np.inf), 1e39, True),
        (np.float16(np.inf), 1e5, True),
        (np.float32(np.inf), 1e5, False),
    ],
)
def test_what_is_not_finite_has_its_answer(found: float, wanted: float, right: bool) -> None:
    assert (checked(np.array([found]), np.array([wanted])) == 0) == right


def test_what_spreads_may_be_anything_that_is_not_finite() -> None:
    assert checked(np.array([np.inf]), np.array([np.nan]), spreads=True) == 0
    assert checked(np.array([7.0]), np.array([np.nan]), spreads=True) == math.inf


def test_warnings_errors_and_missing_results_are_faults() -> None:
    def warn() -> dict[str, float]:
        warnings.warn("overflow", RuntimeWarning, stacklevel=1)
        return {"a": 1.0}

    def fail() -> dict[str, float]:
        raise ZeroDivisionError("division by zero")

    assert measure(Case(warn, lambda: {"a": 1.0}), RANDOM).fault == "warns: overflow"
    assert measure(Case(fail, lambda: {"a": 1.0}), RANDOM).fault == "ZeroDivisionError: division by zero"
    assert measure(Case(fail, lambda: {"a": 1.0}, raises=DataError), RANDOM).fault
    assert measure(Case(fail, lambda: {"a": 1.0}, raises=ZeroDivisionError), RANDOM).fault == ""
    assert measure(Case(lambda: {"a": 1.0}, lambda: {"a": 1.0}, raises=DataError), RANDOM).fault
    assert measure(Case(lambda: {"a": 1.0}, lambda: {"a": 1.0, "b": 2.0}), RANDOM).fault == "results differ: b"


@pytest.mark.parametrize(("slope", "right"), [(2 * X, True), (2.001 * X, False), (np.array([2, -4, np.nan]), False)])
def test_gradients_are_compared_with_differences(slope: np.ndarray, right: bool) -> None:
    gradient = Gradient(lambda: {"x": slope}, lambda at: float((at["x"] ** 2).sum()), {"x": X})
    found = measure(Case(dict, dict, gradient=gradient), RANDOM).gradient
    assert found is not None
    assert (found < tolerances.GRADIENT["fp32"]) == right


def test_precisions_round_as_torch_does() -> None:
    values = RANDOM.normal(size=100) * 10.0 ** RANDOM.integers(-6, 6, 100)
    for precision, kind in zip(PRECISIONS, (torch.float32, torch.bfloat16, torch.float16), strict=True):
        expected = torch.from_numpy(values.astype(np.float32)).to(kind).double().numpy()
        assert np.array_equal(precision.rounded(values), expected)
        assert precision.rounded(precision.smallest) == precision.smallest
        assert precision.rounded(precision.smallest / 4) == 0
        assert precision.rounded(precision.largest) == precision.largest
    assert FP16.array(values).dtype == np.float16 and BF16.tensor(values).dtype == torch.bfloat16


def test_a_third_of_the_places_is_extreme() -> None:
    for each in INPUTS:
        if each.extreme is not None and each.name != "usual":
            values = Given(each, FP32, np.random.default_rng(0)).values(1, 2, (3000,))
            share = float(np.mean((values < 1) | (values > 2) | np.isnan(values)))
            assert 0.3 < share < 0.37, each.name


def broken(name: str = "broken") -> Routine:
    return Routine(name, "a.py", lambda given: Case(lambda: {"a": 1.001}, lambda: {"a": 1.0}))


def test_a_cell_that_fails_is_told_and_exits_with_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    kind = command.ARGUMENTS["priors stress"]
    monkeypatch.setattr(kind, "routines", lambda self: (broken(), ROUTINES[0]))
    assert PROGRAM.run(["stress", "--threads", "1"]) == 1
    text = capsys.readouterr().out
    assert "broken, usual, fp32: value off by 0.001, more than 1e-05" in text
    assert PROGRAM.run(["stress", "--only", "depth"]) == 0
    assert PROGRAM.run(["stress", "--only", "broken", "--json"]) == 1


def test_json_holds_every_cell(capsys: pytest.CaptureFixture[str]) -> None:
    assert PROGRAM.run(["stress", "--only", "depth metrics", "hidden", "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert len(record["cells"]) == 2 * len(INPUTS) * len(PRECISIONS)
    assert record["tolerances"]["value"] == tolerances.VALUE
    table = Table.read(record)
    assert table.record() == record
    assert {each.input for each in table.cells} == {each.name for each in INPUTS}


@pytest.mark.parametrize(
    "arguments", [["--only", "no such"], ["--only", ""], ["--json", "--modes"], ["--markdown", "a.txt"]]
)
def test_what_cannot_be_is_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert PROGRAM.run(["stress", *arguments]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_rows_are_found_by_words_of_their_names() -> None:
    assert [each.name for each in named(ROUTINES, ["DISPARITY METRICS"])] == ["disparity metrics"]
    assert named(ROUTINES, []) == ROUTINES
    with pytest.raises(UsageError, match="cost volume"):
        named(ROUTINES, ["x-ray"])


def test_the_page_keeps_what_stands_around_its_tables(tmp_path: Path) -> None:
    path = tmp_path / "numerics.md"
    path.write_text("# Numerics\n\n<!-- priors stress -->\nold\n<!-- end of priors stress -->\n\nmore\n")
    table = run([ROUTINES[0], broken("x|y")], INPUTS[:3])
    for _ in range(2):
        page.put_into(path, "priors stress", page.markdown([table, replace(table, mode="avx2")], "priors stress"))
    text = path.read_text()
    assert text.startswith("# Numerics\n\n<!-- priors stress -->\n") and text.endswith("stress -->\n\nmore\n")
    assert "old" not in text and text.count("`avx2`") == 1 and "| depth metrics |" in text
    path.write_text("# Numerics\n")
    with pytest.raises(DataError, match="<!-- priors stress -->"):
        page.around(path, "priors stress")


def test_the_same_numbers_are_tested_each_time() -> None:
    assert cell(ROUTINES[0], USUAL, FP32) == cell(ROUTINES[0], USUAL, FP32)


def test_kernels_take_no_float16_for_bfloat16() -> None:
    with pytest.raises(TypeError, match="float16"):
        as_bits(torch.zeros(3, dtype=torch.float16))
