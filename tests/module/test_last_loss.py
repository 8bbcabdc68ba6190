"""2012:10..16: why the position was lost the last time, and the same in EMCY 7300h."""

from __future__ import annotations

import struct

import pytest
from module_bench import Bench

import canfb
from canfb import objects as od
from canfb.cia301.frame import Frame
from canfb.module.module_config import ModuleConfig
from canfb.objects import LossCause, StatusBit
from ideal_tracks import counts_at

LOSS = range(0x10, 0x17)
EMCY = 0xA0


def loss(bench: Bench) -> list[int]:
    """2012:10..16, without the time."""
    return [int(bench.sdo[0x2012][sub].raw) for sub in LOSS if sub != 0x11]


def details(bench: Bench) -> list[bytes]:
    """The five bytes of each EMCY 7300h."""
    frames = [frame.data for frame in bench.heard if frame.can_id == EMCY]
    return [data[3:] for data in frames if struct.unpack_from("<H", data)[0] == 0x7300]


def test_a_bus_that_falls_silent_is_named(bench: Bench) -> None:
    for n in range(20):
        bench.at(0.125 * n)
    assert loss(bench) == [0] * 6, "nothing is lost at first"
    assert bench.sdo[0x2012][0x11].raw == 0
    for _ in range(6):
        bench.sync()
    cause, bad, residual, limit, speed, faults = loss(bench)
    assert cause == LossCause.COASTED
    assert bad == 4, "2010:03 is 3: the fourth is too many"
    assert residual == 32768, "there was nothing to compare"
    assert limit == 21845
    assert speed == pytest.approx(0.125 * 65536, rel=0.01)
    assert faults == StatusBit.MISSED
    not_valid, lost = details(bench)
    assert not_valid[2:] == bytes(3), "the cause is not known yet"
    assert struct.unpack("<H", lost[:2])[0] & StatusBit.LOST
    assert lost[2:] == bytes((LossCause.COASTED, 4, 0))


def test_a_loss_survives_the_restart_that_ends_it_and_is_forgotten_at_a_reset(bench: Bench) -> None:
    """So that it can be asked for when the machine runs again."""
    for _ in range(20):
        bench.at(0.3)
    for _ in range(6):
        bench.sync()
    bench.at(0.3)
    bench.remote.nmt.state = "PRE-OPERATIONAL"
    bench.start()
    assert bench.at(0.3)[1] & StatusBit.VALID
    assert loss(bench)[0] == LossCause.COASTED
    bench.remote.nmt.state = "RESET"
    bench.start()
    assert loss(bench) == [0] * 6


def test_what_was_wrong_is_kept_but_not_what_was_wrong_before_the_last_valid_position(bench: Bench) -> None:
    for n in range(20):
        bench.at(0.125 * n)
    bench.sync()
    bench.sync()  # one is missed
    for n in range(22, 50):
        bench.at(0.125 * n)
    for n in range(50, 60):
        bench.at(0.125 * n, amplitude=100.0)
    cause, bad, *_, faults = loss(bench)
    assert (cause, bad, faults) == (LossCause.COASTED, 4, StatusBit.AMPLITUDE)


def test_a_machine_that_turns_in_a_pause_is_named(bench: Bench) -> None:
    for n in range(50):
        bench.at(0.3 * n)
    bench.remote.nmt.state = "PRE-OPERATIONAL"
    bench.bus.run_until(bench.bus.now + 1.0)
    bench.start()
    bench.at(0.3)
    assert loss(bench)[0] == LossCause.PAUSE


def test_two_samples_for_one_sync_leave_the_time_in_doubt() -> None:
    """Other counts in the same interval: a SYNC may have been missed, or not."""
    module = canfb.FeedbackModule(ModuleConfig(node_id=32, autostart=True))
    module.start(0.0)
    for k in range(1, 200):
        give(module, 0x080, b"", 1e-3 * k)
        give(module, 0x190, counts(0.3 * k), 1e-3 * k + 2e-4)
    give(module, 0x190, counts(0.3 * 200), 0.199 + 3e-4)
    assert module.dictionary.entry(*od.COUNTER_LOSS_CAUSE).current() == LossCause.TIME


def give(module: canfb.FeedbackModule, can_id: int, data: bytes, at: float) -> None:
    module.receive(Frame(can_id, data, timestamp=at), at)


def counts(position_cycles: float) -> bytes:
    return struct.pack("<hh", *counts_at(position_cycles))
