"""Which SYNCs a PDO may answer, by its delay."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.timing.answer_delay import MOST_LATE, REFUSED, TOGETHER, AnswerDelay

PERIOD_S = 1e-3
USUAL = 0.2  # periods


def learned(spread: float = 0.01) -> AnswerDelay:
    delay = AnswerDelay()
    for n in range(40):
        delay.unlearned.append((USUAL + (spread if n % 2 else -spread)) * PERIOD_S)
        if len(delay.unlearned) == TOGETHER:
            delay.learn(PERIOD_S)
    return delay


def answers(
    delay: AnswerDelay, periods: float, before_open: bool = False, stamped: bool = True
) -> tuple[int, ...]:
    return delay.answers(periods * PERIOD_S, periods * PERIOD_S, PERIOD_S, before_open, stamped)


@pytest.mark.parametrize(
    ("periods", "before_open", "offsets"),
    [
        (0.2, False, (0,)),
        (0.2, True, (0,)),
        (0.05, True, (-1,)),
        (0.05, False, (-1,)),
        (0.6, False, (0,)),
        (0.6, True, (-1, 0)),
        (1.2, False, (0, 1)),
        (2.2, False, (0, 1, 2)),
        (7.2, False, (5, 6, 7)),
    ],
)
def test_what_a_delay_proves(periods: float, before_open: bool, offsets: tuple[int, ...]) -> None:
    assert answers(learned(), periods, before_open) == offsets


def test_a_late_host_may_have_the_answer_to_any_sync_since() -> None:
    assert answers(learned(), 3.2, stamped=False) == (0, 1, 2, 3)


@pytest.mark.parametrize(("periods", "before_open", "offsets"), [
    (0.95, False, (0,)),
    (0.95, True, (-1, 0)),
    (1.05, False, (0,)),
    (1.1, False, (0, 1)),
])  # fmt: skip
def test_no_answer_comes_before_its_sync_can(
    periods: float, before_open: bool, offsets: tuple[int, ...]
) -> None:
    delay = learned()
    assert delay.answers(
        periods * PERIOD_S, periods * PERIOD_S, PERIOD_S, before_open, True, 0.95 * PERIOD_S
    ) == offsets  # fmt: skip


def test_a_late_call_of_the_sync_does_not_make_the_answer_too_early() -> None:
    delay = learned()
    assert delay.answers(0.05 * PERIOD_S, 0.2 * PERIOD_S, PERIOD_S, False, False) == (0,)


def test_an_interface_that_has_become_faster_is_learned_again() -> None:
    delay = learned()
    assert [answers(delay, 0.05) for _ in range(REFUSED)] == [(-1,)] * REFUSED
    assert answers(delay, 0.05) == (0,)


def test_before_anything_is_learned_a_pdo_answers_the_last_sync() -> None:
    assert answers(AnswerDelay(), 0.7, before_open=True) == (0,)


@given(st.floats(0.0, 1e9), st.booleans(), st.booleans())
def test_there_are_few_answers_for_any_delay(periods: float, before_open: bool, known: bool) -> None:
    offsets = answers(learned() if known else AnswerDelay(), periods, before_open)
    assert 1 <= len(offsets) <= MOST_LATE + 1
    assert list(offsets) == list(range(offsets[0], offsets[-1] + 1))
