"""How old a position is when it is sent, by transmission types; and 2013h, which predicts it at its SYNC."""

import math
import struct
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import pytest
from hypothesis import given, strategies as st
from module_bench import SYNC, Bench

from canfb import Frame, StatusBit
from canfb.module.objects.prediction import ahead
from drawing import examples

ADC_DELAY, REMOTE_DELAY = 0.25, 0.75  # of a SYNC period
AMPLITUDE = 16000
UNITS_PER_CYCLE = 1 << 20
RANGE = 4095 * UNITS_PER_CYCLE
POSITION_PDO = 0x1A0
Motion = Callable[[int], float]


class Sent(NamedTuple):
    """A position PDO: when it was sent, in SYNC periods, and what it holds."""

    at: float
    position: int
    status: int

    @property
    def cycles(self) -> float:
        return self.position / UNITS_PER_CYCLE


def trapezoid(phase: float) -> float:
    """A track that Table 1 turns into the very phase."""
    eighths = phase % 1.0 * 8.0
    if eighths < 1.0:
        return eighths
    if eighths < 3.0:
        return 1.0
    if eighths < 5.0:
        return 4.0 - eighths
    return -1.0 if eighths < 7.0 else eighths - 8.0


class Timeline(Bench):
    """SYNC k at the time k, the ADC PDO with its sample a quarter of a period later."""

    def __init__(self, motion: Motion, **fields: Any) -> None:
        super().__init__(**{"cycles_per_revolution": 1, "adc_bits": 16, **fields})
        self.motion = motion
        self.syncs = 0
        self.missing: set[int] = set()
        self.positions: list[Sent] = []
        self.bus.observers.append(self._hear)
        sdo = self.sdo
        sdo[0x6000].raw, sdo[0x6001].raw, sdo[0x6002].raw = 4, UNITS_PER_CYCLE, RANGE
        sdo[0x1006].raw = round(self.interval_s * 1e6)

    def types(self, rpdo: int, tpdo: int) -> None:
        """The transmission types of ADC PDO and position PDO; remote frames are allowed."""
        sdo = self.sdo
        sdo[0x1800][1].raw = 0x80000000 | POSITION_PDO
        sdo[0x1800][1].raw = POSITION_PDO
        sdo[0x1400][2].raw, sdo[0x1800][2].raw = rpdo, tpdo

    def run(self, periods: int, *, remote: bool = False) -> list[Sent]:
        """Position PDOs of so many periods."""
        before = len(self.positions)
        for _ in range(periods):
            k = self.syncs
            self._go_to(float(k), SYNC)
            if k not in self.missing:
                self._go_to(k + ADC_DELAY, Frame(0x190, struct.pack("<hh", *self.tracks(k))))
            if remote:
                self._go_to(k + REMOTE_DELAY, Frame(POSITION_PDO, b"", True))
            self.syncs += 1
        return self.positions[before:]

    def tracks(self, k: int) -> tuple[int, int]:
        phase = self.motion(k) % 1.0
        return round(AMPLITUDE * trapezoid(phase)), round(AMPLITUDE * trapezoid(phase + 0.25))

    def sync_errors(self, sent: list[Sent]) -> Iterator[float]:
        """Published minus true position at the SYNC of the PDO, cycles."""
        start = self.motion(0) // 1.0
        for one in sent:
            error = one.cycles - (self.motion(round(one.at)) - start)
            yield (error + 2047.5) % 4095.0 - 2047.5

    def _go_to(self, at: float, frame: Frame) -> None:
        self.bus.run_until(at * self.interval_s)
        self.bus.send(frame)

    def _hear(self, frame: Frame, now: float) -> None:
        if frame.can_id == POSITION_PDO and not frame.rtr:
            position, status, _ = struct.unpack("<IHH", frame.data)
            self.positions.append(Sent(now / self.interval_s, position, status))


STEP = 0.25  # cycles from sample to sample: the position tells which sample it is of
AT_ONCE = (254, 255)


def steady(k: int) -> float:
    return STEP * k


def expected_age(rpdo: int, tpdo: int) -> float:
    """Age of a position PDO in SYNC periods, from the instant at which the tracks were sampled."""
    if tpdo in AT_ONCE:
        return ADC_DELAY if rpdo in AT_ONCE else 1.0
    if tpdo == 253:  # the newest when the remote frame comes
        return REMOTE_DELAY if rpdo in AT_ONCE else 1.0 + REMOTE_DELAY
    return 1.0 + REMOTE_DELAY if tpdo == 252 else 1.0


@pytest.mark.parametrize("tpdo", [0, 1, 2, 240, 252, 253, 254, 255])
@pytest.mark.parametrize("rpdo", [0, 1, 2, 240, 254, 255])
def test_age_by_transmission_types(rpdo: int, tpdo: int) -> None:
    timeline = Timeline(steady)
    timeline.types(rpdo, tpdo)
    timeline.start()
    remote = tpdo in (252, 253)
    timeline.run(4, remote=remote)
    periods = 480 if tpdo == 240 else 12
    sent = timeline.run(periods, remote=remote)
    assert len(sent) == {2: periods // 2, 240: 2}.get(tpdo, periods)
    for one in sent:
        assert one.status == StatusBit.VALID
        assert one.at - round(one.cycles / STEP) == pytest.approx(expected_age(rpdo, tpdo), abs=1e-6)


@pytest.mark.parametrize("rpdo", [1, 255])
@pytest.mark.parametrize("tpdo", [0, 1, 254])
def test_a_missed_sample_is_told_at_the_sync_after_it(rpdo: int, tpdo: int) -> None:
    timeline = Timeline(steady)
    timeline.types(rpdo, tpdo)
    timeline.missing = {20}
    timeline.start()
    told = [one.at for one in timeline.run(25) if one.status & StatusBit.MISSED]
    assert told == pytest.approx([21.0], abs=1e-6)
    assert timeline.sdo[0x2012][1].raw == 1


# Speed and acceleration are differences of positions: they have an age of their own.

JERK, START = 0.001, 0.2  # cycles per period cubed; cycles per period


def test_speed_is_that_of_half_an_interval_before_its_sample_and_acceleration_of_one() -> None:
    timeline = Timeline(lambda k: START * k + JERK * k**3 / 6.0)
    timeline.start()
    timeline.run(40)
    last = timeline.syncs - 1
    sdo, rad = timeline.sdo, 2 * math.pi

    def speed(k: float) -> float:
        return START + JERK * k**2 / 2.0

    per_s = 1.0 / timeline.interval_s
    assert sdo[0x2011][7].raw == pytest.approx(rad * speed(last - 0.5) * per_s, rel=2e-4)
    assert abs(sdo[0x2011][7].raw - rad * speed(last) * per_s) > 0.01 * rad * speed(last) * per_s
    assert sdo[0x2011][9].raw == pytest.approx(rad * JERK * (last - 1) * per_s**2, rel=2e-3)
    assert sdo[0x6030][1].raw == round(speed(last - 0.5) * per_s * 60) or sdo[0x6030][1].raw == 0x7FFF
    # The residual is the size of the same second difference.
    assert sdo[0x2011][2].raw / 65536 == pytest.approx(JERK * (last - 1), abs=1e-4)


VALID, EXTRAPOLATED = int(StatusBit.VALID), int(StatusBit.EXTRAPOLATED)
QUANTUM = 2e-5  # cycles: of the 16-bit converter, and of the position
NOISE = {1: 3, 2: 7}  # how often a formula takes an error of that size at most


def predicting(motion: Callable[[int], float], kind: int, rpdo: int = 255, tpdo: int = 1) -> Timeline:
    timeline = Timeline(motion, predict=kind)
    timeline.types(rpdo, tpdo)
    timeline.start()
    return timeline


def ramp(acceleration: float, periods: int, after: float = 0.0) -> Callable[[int], float]:
    """From standstill with one acceleration, then with another."""

    def position(k: int) -> float:
        first, then = min(k, periods), max(0, k - periods)
        return 0.3 + acceleration * (first**2 / 2 + periods * then) + after * then**2 / 2

    return position


@examples(25)
@given(st.floats(-0.3, 0.3), st.integers(1, 2), st.sampled_from([1, 255]), st.sampled_from([0, 1]))
def test_at_constant_speed_nothing_is_left_of_the_age(
    acceleration: float, kind: int, rpdo: int, tpdo: int
) -> None:
    timeline = predicting(ramp(acceleration, 40), kind, rpdo, tpdo)
    timeline.run(45)
    sent = timeline.run(20)
    assert all(one.status & VALID for one in sent)
    assert max(map(abs, timeline.sync_errors(sent))) < NOISE[kind] * QUANTUM


@given(st.integers(-(2**80), 2**80), st.integers(0, 2**30 - 1), st.integers(-(2**45), 2**45))
def test_the_way_is_exact(cycles: int, phase: int, way: int) -> None:
    """Sixteenths of a millionth, or so, as plain integers."""
    one = 1 << 30
    at, part = ahead(cycles, phase / one, way / one)
    assert isinstance(at, int)
    assert 0.0 <= part < 1.0
    assert at * one + round(part * one) == cycles * one + phase + way


@pytest.mark.parametrize("sequence", [4, 5])
@pytest.mark.parametrize("kind", [1, 2])
def test_wrap_and_code_sequence(sequence: int, kind: int) -> None:
    """Against integers: 2 x(k) - x(k-1), or 3 x(k) - 3 x(k-1) + x(k-2), of the measured positions."""
    timeline = predicting(ramp(0.02, 40, -0.03), kind)
    timeline.sdo[0x6000].raw = sequence
    measured: list[int] = []
    seen = set()
    for k in range(130):
        sent = timeline.run(1)
        if k > 5:
            x, x1, x2 = measured[-1], measured[-2], measured[-3]
            expected = 2 * x - x1 if kind == 1 else 3 * x - 3 * x1 + x2
            assert 0 <= sent[0].position < RANGE
            assert abs((sent[0].position - expected + RANGE // 2) % RANGE - RANGE // 2) <= 7
            seen.add(sent[0].position > RANGE // 2)
        measured.append(timeline.sdo[0x6004].raw)
    assert seen == {False, True}


def test_only_the_synchronous_pdo_is_extrapolated_and_says_so() -> None:
    timeline = predicting(ramp(0.1, 20), 1)
    sdo = timeline.sdo
    timeline.run(30)
    (sent,) = timeline.run(1)
    assert sent.status == VALID | EXTRAPOLATED
    measured = timeline.module.feedback
    assert measured is not None
    assert sdo[0x6004].raw == sdo[0x6008].raw == int((measured.cycles + measured.phase) * UNITS_PER_CYCLE)
    assert sdo[0x2011][1].raw == VALID
    timeline.types(255, 254)
    assert {one.status for one in timeline.run(5)} == {VALID}
    timeline.types(255, 253)
    assert {one.status for one in timeline.run(5, remote=True)} == {VALID}
    timeline.types(255, 252)
    assert {one.status for one in timeline.run(5, remote=True)[1:]} == {VALID | EXTRAPOLATED}


def test_the_event_timer_sends_the_measured_position() -> None:
    timeline = predicting(ramp(0.1, 20), 1, tpdo=254)
    timeline.sdo[0x1800][5].raw = 1  # ms: between a SYNC and its ADC PDO, too
    timeline.missing = set(range(25, 60))
    assert not any(one.status & EXTRAPOLATED for one in timeline.run(40))


def test_it_is_switched_at_run_time_and_from_the_next_sync_on() -> None:
    timeline = predicting(ramp(0.1, 20), 0)
    sdo = timeline.sdo
    timeline.run(30)
    for kind in (1, 0, 2, 0, 1, 2, 1):
        sdo[0x2013][1].raw = kind
        (sent,) = timeline.run(1)
        assert bool(sent.status & EXTRAPOLATED) == bool(kind)
        (error,) = timeline.sync_errors([sent])
        assert abs(error) == pytest.approx(0.0 if kind else 2.0, abs=3 * QUANTUM)


def test_while_coasting_it_goes_on_but_is_never_valid_and_lost_stays_as_counted() -> None:
    timeline = predicting(ramp(0.1, 20), 1)
    timeline.missing = set(range(30, 50))
    timeline.run(30)
    sent = timeline.run(20)
    assert sent[0].status == VALID | EXTRAPOLATED  # at SYNC 30 sample 29 is there
    coasting = [one for one in sent if one.status & StatusBit.COASTING]
    lost = [one for one in sent if one.status & StatusBit.LOST]
    assert len(coasting) == 3
    assert len(lost) == 16
    assert all(one.status & EXTRAPOLATED and not one.status & VALID for one in coasting)
    assert max(map(abs, timeline.sync_errors(coasting))) < 6 * QUANTUM
    assert not any(one.status & (EXTRAPOLATED | VALID) for one in lost)


def test_of_several_samples_since_a_sync_nobody_knows_the_age() -> None:
    timeline = Timeline(steady, predict=True, times=True)
    timeline.types(255, 1)
    timeline.start()
    tick = 0

    def statuses(per_sync: int) -> set[int]:
        nonlocal tick
        seen = set()
        for _ in range(4):
            seen.add(timeline.position(timeline.sync())[1] & EXTRAPOLATED)
            for _ in range(per_sync):
                tick += 10000
                timeline.sent(Frame(0x190, struct.pack("<hhI", 0, AMPLITUDE, tick)))
        return seen

    statuses(1)
    assert statuses(1) == {EXTRAPOLATED}
    statuses(2)
    assert statuses(2) == {0}
