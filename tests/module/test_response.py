"""The delay from SYNC to ADC PDO: which SYNC a PDO answers."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.module.response import LEARNED_SAMPLES, RELEARN_SAMPLES, Answer, Response

PERIOD_S = 1e-3
USUAL_S = 2.5e-4


def judge(response: Response, delay_s: float, after_gap: bool = False) -> Answer:
    return response.judge(delay_s, delay_s, PERIOD_S, after_gap)


def learned(usual_s: float = USUAL_S, jitter_s: float = 0.0, samples: int = 64) -> Response:
    """After some PDOs, alternately ``jitter_s`` later and sooner than usual."""
    response = Response()
    for n in range(samples):
        late_s = jitter_s if n % 2 else -jitter_s
        assert judge(response, usual_s + late_s) is Answer.ON_TIME
    return response


@given(st.floats(1e-5, 8e-4), st.lists(st.floats(0.0, 5e-5), max_size=300))
def test_any_interface_that_answers_within_the_period_is_on_time(usual_s: float, late_s: list[float]) -> None:
    response = learned(usual_s)
    for late in late_s:
        assert judge(response, usual_s + late) is Answer.ON_TIME
    assert usual_s <= response.usual_s <= usual_s + 5e-5


@given(st.floats(1e-4, 8e-4), st.floats(0.0, 0.68))
def test_sooner_than_ever_it_answers_an_earlier_sync(usual_s: float, part: float) -> None:
    response = learned(usual_s)
    before = response.usual_s
    assert judge(response, part * usual_s) is Answer.UNCLEAR
    assert response.usual_s == before, "nothing is learned from it"
    assert judge(response, usual_s) is Answer.ON_TIME


@pytest.mark.parametrize("sooner_s", [2e-5, 1e-4])
def test_an_interface_that_answers_sooner_from_now_on_is_learned(sooner_s: float) -> None:
    response = learned()
    got = [judge(response, sooner_s) for _ in range(RELEARN_SAMPLES + 20)]
    assert got[: RELEARN_SAMPLES - 1] == [Answer.UNCLEAR] * (RELEARN_SAMPLES - 1)
    assert set(got[RELEARN_SAMPLES:]) == {Answer.ON_TIME}
    assert response.usual_s == pytest.approx(sooner_s)


def test_sooner_ones_that_are_not_in_a_row_change_nothing() -> None:
    response = learned()
    for _ in range(5 * RELEARN_SAMPLES):
        assert judge(response, 1e-5) is Answer.UNCLEAR
        assert judge(response, USUAL_S) is Answer.ON_TIME


@pytest.mark.parametrize(
    ("delay", "answer"),
    [
        (0.3, Answer.ON_TIME),
        (0.84, Answer.ON_TIME),  # later than usual, but no other SYNC is due
        (0.95, Answer.UNCLEAR),
        (1.05, Answer.UNCLEAR),
        (1.15, Answer.LATE),
        (1.25, Answer.LATE),
        (2.25, Answer.LATE),
        (7.25, Answer.LATE),
    ],
)
def test_later_than_usual(delay: float, answer: Answer) -> None:
    assert judge(learned(), delay * PERIOD_S) is answer


@pytest.mark.parametrize("delay", [0.95, 1.05, 1.2, 1.45])
def test_an_interface_that_always_needs_that_long_is_on_time(delay: float) -> None:
    """Its PDO comes after the next SYNC was due; what is late is later than usual."""
    response = learned(0.9 * PERIOD_S)
    assert judge(response, delay * PERIOD_S) is Answer.ON_TIME
    assert judge(response, 1.9 * PERIOD_S) is Answer.LATE


@pytest.mark.parametrize(
    ("delay", "answer"),
    [(0.25, Answer.ON_TIME), (0.34, Answer.ON_TIME), (0.36, Answer.UNCLEAR), (0.8, Answer.UNCLEAR)],
)
def test_where_the_one_before_is_missing_only_the_usual_delay_counts(delay: float, answer: Answer) -> None:
    assert judge(learned(), delay * PERIOD_S, after_gap=True) is answer


def test_what_is_usual_depends_on_how_much_it_varies() -> None:
    later_s = USUAL_S + 1.6e-4
    assert judge(learned(), later_s, after_gap=True) is Answer.UNCLEAR
    assert judge(learned(jitter_s=5e-5), later_s, after_gap=True) is Answer.ON_TIME


def test_before_it_is_learned_only_a_whole_period_is_late() -> None:
    for seen in range(LEARNED_SAMPLES):
        response = learned(samples=seen)
        assert judge(response, 1e-5) is Answer.ON_TIME
        response = learned(samples=seen)
        assert judge(response, 0.95 * PERIOD_S, after_gap=True) is Answer.ON_TIME
        response = learned(samples=seen)
        assert judge(response, 1.3 * PERIOD_S) is Answer.LATE


def test_forgotten_it_learns_from_the_next() -> None:
    response = learned(7e-4)
    response.forget()
    assert judge(response, 1e-4) is Answer.ON_TIME
    assert response.usual_s == pytest.approx(1e-4)


@given(st.lists(st.tuples(st.floats(0.0, 1e4), st.booleans()), max_size=60))
def test_nothing_is_on_time_that_came_after_the_next_sync_and_later_than_usual(
    delays: list[tuple[float, bool]],
) -> None:
    response = learned()
    for delay, after_gap in delays:
        usual_s = response.usual_s
        got = judge(response, delay * PERIOD_S, after_gap)
        if delay > 1.1 and delay * PERIOD_S - usual_s > 0.6 * PERIOD_S:
            assert got is not Answer.ON_TIME
