"""Folded cases: each is tried, and a failing one is named."""

import inspect

import pytest

from folding import each


def test_every_combination_is_tried_and_fixtures_are_passed_on() -> None:
    tried = []

    @each("one", [1, 2])
    @each("two, three", [("a", 3.0), ("b", 4.0)])
    def checks(fixture: str, one: int, two: str, three: float) -> None:
        tried.append((fixture, one, two, three))

    assert list(inspect.signature(checks).parameters) == ["fixture"]
    checks(fixture="f")
    assert tried == [("f", 1, "a", 3.0), ("f", 1, "b", 4.0), ("f", 2, "a", 3.0), ("f", 2, "b", 4.0)]


def test_failing_cases_are_named_and_the_others_tried() -> None:
    tried = []

    @each("number", range(100))
    def checks(number: int) -> None:
        tried.append(number)
        assert number not in (7, 60), "no good"

    with pytest.raises(
        AssertionError, match=r"2 of 100 cases fail:\n  number=7: .*\n  number=60: "
    ) as caught:
        checks()
    assert "no good" in str(caught.value)
    assert isinstance(caught.value.__cause__, AssertionError)
    assert tried == list(range(100))
