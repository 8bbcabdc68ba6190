"""An inhibit time counts from the moment at which the frame has left, however late that was."""

from __future__ import annotations

import itertools
import math
import struct
from typing import Any

import can
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from canfb.bus.runner import Runner
from canfb.device.device_protocol import Device, Inhibited
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from drawing import examples
from fake_bus import FakeBus, FakeClock, each_kind_of_bus, frame_bus, message  # noqa: F401

POSITION, EMCY = 0x1A0, 0xA0
INHIBIT_S = 0.010


class SlowBus(FakeBus):
    """Each frame leaves later than it is given; the time passes for the program as well."""

    def __init__(self, clock: FakeClock, plan: Any, delays_s: list[float]) -> None:
        super().__init__(clock, plan)
        self._delays_s = delays_s

    def send(self, message: can.Message) -> None:
        self.clock.now += self._delays_s[len(self.sent) % len(self._delays_s)]
        super().send(message)

    def times_of(self, can_id: int) -> list[float]:
        return [at for at, sent in self.sent if sent.arbitration_id == can_id]


def sdo(request: str) -> can.Message:
    return message(0x620, bytes.fromhex(request))


def played(delays_s: list[float], samples: int = 60) -> SlowBus:
    """Both inhibit times 10 ms, a sample each millisecond, an EMCY at every third."""
    clock = FakeClock()
    plan = [
        (0.10, sdo("23001801A00100C0")),  # not valid
        (0.15, sdo("2B00180364000000")),  # inhibit time 100 x 100 us
        (0.20, sdo("23001801A0010040")),
        (0.25, sdo("2B15100064000000")),  # that of EMCY
        (0.30, message(0, b"\x01\x20")),
    ]
    for n in range(samples):
        at = 0.5 + 1e-3 * n
        amplitude = 1500 if n // 3 % 2 else 20  # too small: EMCY; then its end
        counts = (round(amplitude * f(0.05 * n)) for f in (math.sin, math.cos))
        plan += [(at, message(0x80)), (at, message(0x190, struct.pack("<hh", *counts)))]
    bus = SlowBus(clock, plan, delays_s)
    module: Device = FeedbackModule(ModuleConfig(node_id=32))
    assert isinstance(module, Inhibited)
    fake: Any = bus
    runner = Runner(frame_bus(fake), [module], clock=clock, sleep=clock.sleep)
    runner.run(finished=lambda: bus.at > 1.0)
    return bus


@given(st.lists(st.floats(0.0, 0.009), min_size=1, max_size=9))
@example([0.0])
@examples(20)
def test_no_two_frames_are_closer_than_the_inhibit_time(delays_s: list[float]) -> None:
    bus = played(delays_s)
    for can_id in (POSITION, EMCY):
        times = bus.times_of(can_id)
        assert len(times) >= 3
        gaps = [later - earlier for earlier, later in itertools.pairwise(times)]
        assert min(gaps) >= 0.999999 * INHIBIT_S
        assert max(delays_s) > 0.0 or gaps[1] == pytest.approx(INHIBIT_S, abs=1e-6)
