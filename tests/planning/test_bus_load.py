"""The worst-case load of a bus: frames as an independent count of their bits has them, rates by their PDO."""

import math

import pytest
from hypothesis import given, strategies as st
from planning_kit import planned

from canfb.cia301.frame import frame_bits
from canfb.planning.planned_bus import (
    BIT_RATES,
    BusLoad,
    Message,
    Values,
    adc_messages,
    in_order,
    node_messages,
    sync_message,
)
from canfb.simulation.embedded_bus import LONGEST_FRAME_BITS
from drawing import examples
from folding import each

NODE = 0x20


def tpdo(kind: int, inhibit: int = 0, timer: int = 0, mapped: int = 0x60040020) -> Values:
    return {
        (0x1800, 1): 0x180 + NODE,
        (0x1800, 2): kind,
        (0x1800, 3): inhibit,
        (0x1800, 5): timer,
        (0x1A00, 0): 1,
        (0x1A00, 1): mapped,
        (0x1014, 0): 1 << 31,
    }


@each("kind, inhibit, timer, sampled, rate_hz, follows", [
    (1, 0, 0, True, 1000.0, True),
    (4, 0, 0, True, 250.0, True),
    (240, 0, 0, True, 1000.0 / 240.0, True),
    (0, 0, 0, True, 1000.0, True),
    (254, 0, 0, True, 1000.0, True),
    (255, 100, 0, True, 100.0, False),  # 10 ms between two
    (254, 5, 0, True, 1000.0, True),  # 0.5 ms: nothing waits
    (254, 0, 50, True, 1000.0, True),  # a timer that each sample begins again
    (255, 0, 50, False, 20.0, False),  # of a node without samples
    (255, 0, 0, False, 0.0, False),
    (1, 100, 50, True, 1000.0, True),  # both are of no concern to a synchronous one
    (252, 0, 0, True, 0.0, False),  # on remote frames
    (253, 0, 0, True, 0.0, False),
])  # fmt: skip
def test_the_rate_of_a_pdo(
    kind: int, inhibit: int, timer: int, sampled: bool, rate_hz: float, follows: bool
) -> None:
    (message,) = node_messages(tpdo(kind, inhibit, timer), NODE, sampled=sampled)
    assert message.rate_hz(1000.0) == pytest.approx(rate_hz)
    assert message.follows_sync(1000.0) is follows
    assert (message.data_bytes, message.bits) == (4, frame_bits(4))


def test_an_event_timer_shorter_than_the_interval_sends_between_samples() -> None:
    (message,) = node_messages(tpdo(254, timer=10), NODE, sampled=True)
    assert message.rate_hz(30.0) == 130.0
    assert not message.follows_sync(30.0)


def test_heartbeats_emcy_and_what_is_not_valid() -> None:
    values = {**tpdo(1), (0x1800, 1): 1 << 31 | 0x1A0, (0x1014, 0): 0xA0, (0x1015, 0): 1000, (0x1017, 0): 500}
    heartbeat, emcy = node_messages(values, NODE, sampled=True)
    assert (heartbeat.can_id, heartbeat.rate_hz(1.0), heartbeat.data_bytes) == (0x720, 2.0, 1)
    assert (emcy.can_id, emcy.rate_hz(1.0)) == (0xA0, 10.0)
    assert emcy.on_error
    assert sync_message({(0x1019, 0): 10}).data_bytes == 1
    assert sync_message({(0x1005, 0): 1 << 30 | 0x81}).can_id == 0x81
    assert adc_messages({(0x1400, 1): 1 << 31 | 0x190}) == []


def test_the_frames_of_a_module_as_delivered() -> None:
    bus = planned().bus
    found = {message.can_id: (message.data_bytes, message.rate_hz(1000.0)) for message in bus.messages}
    assert found == {
        0x80: (0, 1000.0),
        0x90: (8, 20.0),
        0xA0: (8, 20.0),
        0x190: (4, 1000.0),
        0x1A0: (8, 1000.0),
        0x2A0: (8, 1000.0),
    }
    bits = 1000 * (frame_bits(0) + frame_bits(4) + 2 * frame_bits(8)) + 40 * frame_bits(8)
    assert bus.load == pytest.approx(bits / 1e6)
    assert bus.load_at(bus.largest_sync_hz) == pytest.approx(1.0)
    assert planned(times=True).bus.load > bus.load


@examples(12)
@given(
    modules=st.integers(1, 12),
    rate_hz=st.floats(1.0, 5000.0),
    extra=st.floats(0.0, 0.9),
    faster=st.floats(1.01, 3.0),
)
def test_the_load_grows_with_all_that_is_added(
    modules: int, rate_hz: float, extra: float, faster: float
) -> None:
    words = {"rate_hz": rate_hz, "extra_load": extra, "heartbeat_ms": 100.0}
    bus = planned(modules, **words).bus
    assert planned(modules + 1, **words).bus.load > bus.load
    assert planned(modules + 1, **words).bus.largest_sync_hz <= bus.largest_sync_hz
    assert bus.load_at(rate_hz * faster) > bus.load
    assert planned(modules, **{**words, "extra_load": extra + 0.05}).bus.load > bus.load
    assert planned(modules, **{**words, "heartbeat_ms": 50.0}).bus.load > bus.load
    slower = planned(modules, **words, bit_rate=500_000).bus
    assert slower.load > bus.load
    assert slower.largest_sync_hz <= bus.largest_sync_hz
    if bus.largest_sync_hz:
        assert (rate_hz <= bus.largest_sync_hz) is (bus.load <= 1.0) or math.isclose(bus.load, 1.0)


def test_what_delays_a_sync() -> None:
    def delay_us(**words: float) -> float:
        return planned(**words).bus.sync_delay_s * 1e6

    assert delay_us() == 0.0, "all frames follow a SYNC, and are through before the next one"
    assert delay_us(heartbeat_ms=100.0) == frame_bits(1)
    assert delay_us(extra_load=0.01) == LONGEST_FRAME_BITS
    assert delay_us(rate_hz=2700.0) == LONGEST_FRAME_BITS, "not through"


def test_a_can_id_is_sent_by_one_node_and_stands_once() -> None:
    one = Message(can_id=0x190, kind="ADC PDO", data_bytes=4, each_syncs=1)
    two = Message(can_id=0x190, kind="for RPDO1", data_bytes=4, each_syncs=1)
    first = Message(can_id=0x80, kind="SYNC", data_bytes=0, each_syncs=1)
    assert in_order([one, two, first]) == (first, one)
    assert BusLoad(1_000_000, 100.0, (first, one)).longest_turn_s == pytest.approx(150e-6)
    assert sorted(BIT_RATES) == list(BIT_RATES)
