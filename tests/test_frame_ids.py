"""Frame ids: numbers sort and join as numbers, and nothing is joined by guess."""

from hypothesis import given
from hypothesis import strategies as st

from priors.frame_ids import in_order, joined
from priors.selection import select

SPELLINGS = st.lists(st.tuples(st.integers(0, 300), st.integers(1, 10)), unique_by=lambda pair: pair[0], max_size=12)


@given(SPELLINGS)
def test_numbers_of_any_width_sort_as_numbers(pairs: list[tuple[int, int]]) -> None:
    ids = in_order(f"{number:0{width}d}" for number, width in pairs)
    assert [int(id_) for id_ in ids] == sorted(number for number, _ in pairs)


def test_names_and_times_sort_as_people_read_them() -> None:
    assert in_order(["img10", "img9", "b", "2", "a"]) == ["2", "a", "b", "img9", "img10"]
    assert in_order(["1305031102.5", "1305031102.25", "999.9"]) == ["999.9", "1305031102.25", "1305031102.5"]


@given(SPELLINGS, st.data())
def test_each_frame_gets_the_file_of_its_number(pairs: list[tuple[int, int]], data: st.DataObject) -> None:
    files = {f"{number:0{width}d}": number for number, width in pairs}
    ids = [f"{number:0{data.draw(st.integers(1, 10))}d}" for number, _ in pairs]
    assert joined(ids, files) == {id_: int(id_) for id_ in ids}


def test_what_two_have_is_joined_by_equal_text_only() -> None:
    assert joined(["7"], {"07": 1, "007": 2}) == {"07": 1, "007": 2}
    assert joined(["7"], {"7": 1, "007": 2}) == {"7": 1, "007": 2}
    assert joined(["7", "07"], {"007": 1}) == {"007": 1}
    assert joined(["7", "07"], {"7": 1}) == {"7": 1}
    assert joined(["a", "7"], {"a": 1, "b": 2, "0008": 3}) == {"a": 1, "b": 2, "0008": 3}


def test_digits_that_are_no_numbers_are_names() -> None:
    assert select(["\u00b2", "\u00b3"], "0:1") == [0]
    assert in_order(["\u00b2", "1"]) == ["1", "\u00b2"]
