"""Sample time and its clock, flags, zero pulse and coarse track of the interface, and their PDOs."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from canfb.cia301.frame import Frame
from canfb.interface.encoder_interface import EncoderInterface
from canfb.interface.sample_instants import SampleClock
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.signal.sample import Sample
from folding import each

NODE = 16
SYNC = Frame(0x80, b"")
FULL = Sample(1, -2, coarse_sine=3, coarse_cosine=-4, zero_pulse=0.25)


class Played:
    """A source that plays these samples, the last one again and again; None is a sample lost."""

    def __init__(self, *samples: Sample | None) -> None:
        self._samples = list(samples)

    def next(self) -> Sample | None:
        return self._samples.pop(0) if len(self._samples) > 1 else self._samples[0]


def running(
    *samples: Sample | None, times: bool = False, clock: SampleClock | None = None
) -> EncoderInterface:
    interface = EncoderInterface(NODE, Played(*samples), autostart=True, times=times, clock=clock)
    interface.start(0.0)
    return interface


def with_tpdo2(interface: EncoderInterface) -> EncoderInterface:
    """TPDO2 is switched on as a master does it, by its COB-ID alone."""
    cob_id = (0x40000280 + NODE).to_bytes(4, "little")
    (answer,) = interface.receive(Frame(0x600 + NODE, b"\x23\x01\x18\x01" + cob_id), 0.0)
    assert answer.data[0] == 0x60
    return interface


def test_as_delivered_tpdo1_is_both_tracks_and_nothing_else_goes_out() -> None:
    assert running(FULL).receive(SYNC, 0.5) == [Frame(0x190, struct.pack("<hh", 1, -2))]


def test_with_times_tpdo1_has_the_sample_time_behind_the_tracks() -> None:
    interface = running(FULL, times=True, clock=SampleClock(0.0, 1000))
    assert interface.receive(SYNC, 0.5) == [Frame(0x190, struct.pack("<hhI", 1, -2, 5_001_000))]


def test_the_sample_time_is_that_of_the_reception_by_the_clock_of_the_bus() -> None:
    """Whenever the program comes round to the SYNC; a stamp of some other clock is not used."""
    interface = running(FULL, times=True)
    stamps = [
        struct.unpack_from("<I", interface.receive(SYNC._replace(timestamp=stamp), 2.0)[0].data, 4)[0]
        for stamp in (1.9995, None, 2.1, 1.7e9, -20.0)
    ]
    assert stamps == [19_995_000, 20_000_000, 20_000_000, 20_000_000, 20_000_000]


def test_a_sample_with_a_time_of_its_own_keeps_it() -> None:
    interface = running(FULL._replace(time_100ns=77), times=True, clock=SampleClock(0.0, 1000))
    assert struct.unpack_from("<I", interface.receive(SYNC, 0.5)[0].data, 4) == (77,)


def test_tpdo2_holds_coarse_track_flags_and_zero_pulse() -> None:
    interface = with_tpdo2(running(FULL, Sample(1, -2, invalid=True), FULL._replace(zero_pulse=1.0)))
    sent = [interface.receive(SYNC, 0.001 * n)[1] for n in range(3)]
    assert [frame.can_id for frame in sent] == [0x290] * 3
    fields = [struct.unpack("<hhBH", frame.data) for frame in sent]
    assert fields[0] == (3, -4, 1, 16384)
    assert fields[1][2] == 2, "no pulse in this one, and the interface itself calls it bad"
    assert fields[2] == (3, -4, 1, 65535)


def test_a_lost_sample_is_lost_in_both_pdos() -> None:
    interface = with_tpdo2(running(FULL, None, FULL))
    assert [len(interface.receive(SYNC, 0.001 * n)) for n in range(3)] == [2, 0, 2]


@pytest.mark.parametrize("times", [False, True])
def test_the_module_takes_what_the_interface_sends(times: bool) -> None:
    interface = running(Sample(1200, 900), times=times)
    module = FeedbackModule(
        ModuleConfig(node_id=32, encoder_interface=NODE, times=times, autostart=True, adc_bits=12)
    )
    module.start(0.0)
    entry = module.dictionary.entry
    for n in range(1, 4):
        now = 0.001 * n
        module.receive(SYNC, now)
        for frame in interface.receive(SYNC, now):
            assert len(frame.data) == (8 if times else 4)
            module.receive(frame, now)
    assert (entry(0x2000, 1).value, entry(0x2000, 2).value) == (1200, 900)
    assert entry(0x2000, 5).value == (30_000 if times else 0)
    assert entry(0x2012, 8).value == 0
    assert module.feedback is not None
    assert module.feedback.valid
    assert entry(0x1600, 0).value == (3 if times else 2)


def test_times_are_a_matter_of_the_default_a_master_may_write_another_mapping() -> None:
    module = FeedbackModule(ModuleConfig(node_id=32, times=True))
    module.start(0.0)
    for data in (b"\x23\x00\x14\x01\x90\x01\x00\x80", b"\x2f\x00\x16\x00\x00", b"\x2f\x00\x16\x00\x02"):
        (answer,) = module.receive(Frame(0x620, data.ljust(8, b"\0")), 0.0)
        assert answer.data[0] == 0x60
    assert module.dictionary.entry(0x1600, 0).value == 2


WRAP = 1 << 32
drifts = st.floats(-10_000, 10_000)
starts = st.integers(-(1 << 40), 1 << 40)
times = st.floats(0, 1e7)  # of a monotonic clock: four months
steps = st.floats(0, 420)  # less than a turn of the clock


@given(drifts, starts, times, steps)
def test_ticks_pass_as_time_does_whatever_it_shows(
    drift_ppm: float, start: int, now: float, step_s: float
) -> None:
    clock = SampleClock(drift_ppm, start)
    first, second = clock.ticks(now), clock.ticks(now + step_s)
    assert 0 <= first < WRAP
    passed = (second - first) % WRAP
    # A tick at either end, and what a float of such a time cannot hold.
    assert passed == pytest.approx(step_s * 1e7 * (1 + drift_ppm * 1e-6), abs=1.1 + 4 * math.ulp(now) * 1e7)


@given(starts)
def test_it_wraps_after_429_seconds(start: int) -> None:
    clock = SampleClock(0.0, start)
    turn_s = WRAP * 1e-7
    assert clock.ticks(0.0) == start % WRAP
    assert clock.ticks(turn_s + 1e-9) == start % WRAP
    assert clock.ticks(turn_s - 5e-8) == (start - 1) % WRAP


@each("drift_ppm", [10_001, -10_001, math.nan, math.inf])
def test_a_drift_that_no_clock_has_is_refused(drift_ppm: float) -> None:
    with pytest.raises(ValueError, match="drift_ppm must be a number"):
        SampleClock(drift_ppm)
