"""A machine whose position is known at every SYNC, on a bus where time passes within a period."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

from module_bench import SYNC, Bench

from canfb.cia301.frame import Frame

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


class Timeline:
    """SYNC k at the time k, the ADC PDO with its sample a quarter of a period later."""

    def __init__(self, motion: Motion, **fields: Any) -> None:
        self.bench = Bench(**{"cycles_per_revolution": 1, "adc_bits": 16, **fields})
        self.motion = motion
        self.syncs = 0
        self.missing: set[int] = set()
        self.sent: list[Sent] = []
        self.begin_s = self.bench.bus.now
        self.period_s = 1e-3
        self.bench.bus.observers.append(self._hear)
        sdo = self.bench.sdo
        sdo[0x6000].raw, sdo[0x6001].raw, sdo[0x6002].raw = 4, UNITS_PER_CYCLE, RANGE
        sdo[0x1006].raw = round(self.period_s * 1e6)

    def types(self, rpdo: int, tpdo: int) -> None:
        """The transmission types of ADC PDO and position PDO; remote frames are allowed."""
        sdo = self.bench.sdo
        sdo[0x1800][1].raw = 0x80000000 | POSITION_PDO
        sdo[0x1800][1].raw = POSITION_PDO
        sdo[0x1400][2].raw, sdo[0x1800][2].raw = rpdo, tpdo

    def start(self) -> None:
        self.bench.start()

    def run(self, periods: int, *, remote: bool = False) -> list[Sent]:
        """Position PDOs of so many periods."""
        before = len(self.sent)
        for _ in range(periods):
            k = self.syncs
            self._go_to(float(k), SYNC)
            if k not in self.missing:
                self._go_to(k + ADC_DELAY, Frame(0x190, struct.pack("<hh", *self.counts(k))))
            if remote:
                self._go_to(k + REMOTE_DELAY, Frame(POSITION_PDO, b"", True))
            self.syncs += 1
        return self.sent[before:]

    def counts(self, k: int) -> tuple[int, int]:
        phase = self.motion(k) % 1.0
        return round(AMPLITUDE * trapezoid(phase)), round(AMPLITUDE * trapezoid(phase + 0.25))

    def sync_errors(self, sent: list[Sent]) -> Iterator[float]:
        """Published minus true position at the SYNC of the PDO, cycles."""
        start = self.motion(0) // 1.0
        for one in sent:
            error = one.cycles - (self.motion(round(one.at)) - start)
            yield (error + 2047.5) % 4095.0 - 2047.5

    def _go_to(self, at: float, frame: Frame) -> None:
        self.bench.bus.run_until(self.begin_s + at * self.period_s)
        self.bench.bus.send(frame)

    def _hear(self, frame: Frame, now: float) -> None:
        if frame.can_id == POSITION_PDO and not frame.rtr:
            position, status, _ = struct.unpack("<IHH", frame.data)
            self.sent.append(Sent((now - self.begin_s) / self.period_s, position, status))
