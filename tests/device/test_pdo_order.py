"""The communication parameters of a PDO that is not valid go in any order; bit 31 is where they must fit."""

from __future__ import annotations

from pathlib import Path

from device_kit import ID, OK, Bench
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301 import cob
from canfb.cia301.codes import AbortCode
from canfb.device.od.dictionary import Dictionary
from folding import each

EDS = Path(__file__).parents[2] / "eds" / "canfb-module.eds"
DICTIONARY = Dictionary.load(EDS, ID)
SIZES = {1: 4, 2: 1, 3: 2, 5: 2, 6: 1}
RECEIVED, SENT = (0x1400, 0x1401), (0x1800, 0x1801, 0x1802, 0x1803)
REMOTE_ONLY = (0xFC, 0xFD)
NO_RTR, FREE = cob.NO_RTR, cob.NOT_VALID
CAN_IDS = st.integers(0, 0x7FF).filter(lambda can_id: not cob.is_restricted(can_id))
State = dict[int, int]


def is_legal(state: State) -> bool:
    """Whether a valid PDO may be as it is."""
    return not (state[2] in REMOTE_ONLY and state[1] & NO_RTR)


@st.composite
def states(draw: st.DrawFn, index: int) -> State:
    """Communication parameters, each good by itself; the COB-ID as that of a valid PDO."""
    remote = REMOTE_ONLY if index in SENT else ()
    kinds = st.one_of(st.integers(0, 240), st.sampled_from([254, 255, *remote, *remote]))
    values = {
        1: draw(CAN_IDS) | draw(st.sampled_from([0, NO_RTR])),
        2: draw(kinds),
        3: draw(st.integers(0, 0xFFFF)),
        5: draw(st.integers(0, 0xFFFF)),
        6: draw(st.integers(0, 240)),
    }
    return {sub: value for sub, value in values.items() if (index, sub) in DICTIONARY}


@st.composite
def programs(draw: st.DrawFn) -> tuple[int, State, list[tuple[int, int]]]:
    """A PDO, its last state, and writes that lead there by way of any others while it is not valid."""
    index = draw(st.sampled_from([*RECEIVED, *SENT]))
    last = draw(states(index))
    detours = [
        (sub, value) for state in draw(st.lists(states(index), max_size=3)) for sub, value in state.items()
    ]
    before = draw(st.permutations(detours))
    arrival = draw(st.permutations(list(last.items())))
    return index, last, [(sub, value | FREE if sub == 1 else value) for sub, value in [*before, *arrival]]


BENCH = Bench(DICTIONARY)
BENCH.start()


def as_delivered() -> Bench:
    """One node for all examples, reset: to read an EDS takes longer than an example."""
    BENCH.nmt(129)
    return BENCH


def state_of(bench: Bench, index: int) -> State:
    return {sub: bench.read(index, sub) for sub in SIZES if (index, sub) in bench.dictionary}


@given(programs())
def test_any_order_leads_to_any_state(program: tuple[int, State, list[tuple[int, int]]]) -> None:
    index, last, writes = program
    bench = as_delivered()
    assert bench.write(index, 1, bench.read(index, 1) | FREE, 4) == OK
    assert {bench.write(index, sub, value, SIZES[sub]) for sub, value in writes} == {OK}
    assert state_of(bench, index) == last | {1: last[1] | FREE}
    answer = bench.write(index, 1, last[1], 4)
    assert answer == (OK if is_legal(last) else AbortCode.INVALID_VALUE)
    assert bench.read(index, 1) == (last[1] if is_legal(last) else last[1] | FREE)


COB_IDS = [(0x1005, 0), (0x1012, 0), (0x1014, 0), (0x1201, 1), (0x1201, 2)]
COB_IDS += [(index, 1) for index in (*RECEIVED, *SENT)]


@each("place", COB_IDS)
@each("bits", [1 << 29, 1 << 11, 1 << 28, 0x1FFFF800])
def test_frames_of_29_bits_are_refused_whether_it_is_valid_or_not(place: tuple[int, int], bits: int) -> None:
    bench = as_delivered()
    value = bench.read(*place)
    for switch in (0, FREE):
        assert bench.write(*place, value | bits | switch, 4) is AbortCode.INVALID_VALUE
    assert bench.read(*place) == value
