"""JSON that others may have written: numbers at the bounds, and messages that say where and what."""

import math
from typing import Any

import pytest

from baselines.tools.schema import FLAG, INTEGER, NUMBER, TEXT, check, in_a_line, list_of, mapping_of, object_of, parse

MOST = 2**63 - 1
LARGEST = 1.7976931348623157e308  # float64


@pytest.mark.parametrize("number", [0, -7, MOST, -MOST, 1.5, -2.5e-300, LARGEST, -LARGEST])
def test_numbers_are_read_as_they_are(number: float):
    found = parse(f'{{"a": [{number}]}}'.encode())
    assert found == {"a": [number]} and type(found["a"][0]) is type(number)


@pytest.mark.parametrize("text", [str(MOST + 1), str(-MOST - 1), "1e309", "-1e309", "NaN", "Infinity", "-Infinity"])
def test_numbers_that_are_not_finite_or_too_large(text: str):
    with pytest.raises(ValueError, match=f"its number {text[:20]} is not finite, or too large"):
        parse(f"[{text}]".encode())


@pytest.mark.parametrize("data", [b"", b"{", b"\xff", b'"\\ud800"', b"[1] 2"])
def test_what_is_no_json(data: bytes):
    with pytest.raises(ValueError, match=r"."):
        parse(data)


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (" two\n\t words ", "two words"),
        ("bell\a", "bell?"),
        ([1, None], "[1, None]"),
        ("a" * 20, "a" * 20),
        ("a" * 21, "a" * 17 + "..."),
        ("a" * 10**6, "a" * 17 + "..."),
        (" " * 30 + "a" * 30, "a" * 10),
    ],
)
def test_in_a_line(value: object, shown: str):
    assert in_a_line(value, 20) == shown


def test_a_line_has_200_letters_unless_told():
    assert in_a_line("a" * 200) == "a" * 200
    assert in_a_line("a" * 201) == "a" * 197 + "..."


BOOK = object_of(
    ("pages",),
    title=TEXT,
    pages=INTEGER,
    price=NUMBER,
    lent=FLAG,
    kind={"enum": ["paper", "film"]},
    chapters=list_of(object_of(name=TEXT)),
    marks=mapping_of(NUMBER),
)
GOOD: dict[str, Any] = {
    **{"title": "Arms", "pages": 3, "price": 2.5, "lent": False, "kind": "film"},
    **{"chapters": [{"name": "one"}, {"name": "two"}], "marks": {"a": 1, "b": 0.5}, "more": None},
}


def test_what_fits():
    check(GOOD, "the book", BOOK)
    check({name: value for name, value in GOOD.items() if name != "pages"}, "the book", BOOK)
    check({**GOOD, "price": LARGEST, "chapters": [], "marks": {}}, "the book", BOOK)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"title": 3}, "the book: title must be a text, got '3'"),
        ({"pages": 3.5}, "the book: pages must be an integer, got '3.5'"),
        ({"pages": True}, "the book: pages must be an integer, got 'True'"),
        ({"price": math.nan}, "the book: price must be a finite number, got 'nan'"),
        ({"price": -math.inf}, "the book: price must be a finite number, got '-inf'"),
        ({"price": True}, "the book: price must be a finite number, got 'True'"),
        ({"price": "1"}, "the book: price must be a finite number, got '1'"),
        ({"price": 10**309}, f"the book: price must be a finite number, got '1{'0' * 76}...'"),
        ({"lent": 0}, "the book: lent must be true or false, got '0'"),
        ({"kind": "song"}, "the book: kind must be one of paper, film, got 'song'"),
        ({"chapters": {}}, "the book: chapters must be a list, got '{}'"),
        ({"chapters": [{"name": "one"}, {}]}, "the book: chapters[1]: name must be there"),
        ({"chapters": [3]}, "the book: chapters[0] must be an object, got '3'"),
        ({"marks": {"a\nb": "x"}}, "the book: marks: 'a\\nb' must be a finite number, got 'x'"),
    ],
)
def test_what_does_not_fit(change: dict[str, Any], message: str):
    with pytest.raises(ValueError, match=r".") as caught:
        check({**GOOD, **change}, "the book", BOOK)
    assert str(caught.value) == message


def test_what_lacks():
    for name in GOOD.keys() - {"pages", "more"}:
        with pytest.raises(ValueError, match=f"^the book: {name} must be there$"):
            check({other: value for other, value in GOOD.items() if other != name}, "the book", BOOK)


def test_another_rule_is_told_in_its_own_words():
    with pytest.raises(ValueError, match=r"^it\[0\]: 3 is greater than the maximum of 2$"):
        check([3], "it", list_of({"type": "integer", "maximum": 2}))
