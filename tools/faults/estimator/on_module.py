"""The same episodes as SYNCs and PDOs through the whole module, one sample for each SYNC.

Whole cycles per sample do not show in the samples: the module sees the machine at the speed less a multiple
of 8 cycles per sample, to which it is accelerated before its limits are written. What is missing has no PDO,
what is flagged has bit 1 of 2000:06.
"""

from __future__ import annotations

import math
import struct

import numpy as np

from canfb import FeedbackModule, Frame
from canfb.eds_files import eds_path
from tools.faults.estimator.declared import COAST_SAMPLES, Declared
from tools.faults.estimator.episodes import VALID, Episode, Published
from tools.faults.estimator.kinds import State
from tools.faults.estimator.machine import counts
from tools.faults.wire.setups import (
    ADC_ID,
    CYCLES_PER_REVOLUTION,
    NMT_ID,
    NODE,
    RANGE_CYCLES,
    SETUPS,
    SYNC_ID,
    TPDO1_ID,
    TWO_PI,
    UNITS_PER_CYCLE,
    Bench,
    Options,
    sdo_write,
)

INTERVAL_S = 1e-3
PDO_LATER_S = 0.3e-3
RAMP_CYCLES = 0.25
REST = 8
SETTLED = 12
HIDDEN_CYCLES = 8.0
COUNTER = next(one for one in SETUPS if one.name == "counter")
MAPPED = (0x20000110, 0x20000210, 0x20000608)
BAD_SAMPLES_SUBINDEX, PHASE_ERROR_SUBINDEX = 0x0A, 0x0C
_EDS = eds_path("canfb-module").read_text(encoding="utf-8").lower()


class _Line(Bench):
    """A module with the SYNC counter, and what has been sent to it."""

    def __init__(self) -> None:
        super().__init__()
        self._number = 0

    def power_on(self) -> None:
        self._number = 0
        module = self.begin(COUNTER, Options(period=True))
        self._write(0x1400, 1, "I", 0x80000000 | ADC_ID)
        self._write(0x1600, 0, "B", 0)
        for number, entry in enumerate(MAPPED, 1):
            self._write(0x1600, number, "I", entry)
        self._write(0x1600, 0, "B", len(MAPPED))
        self._write(0x1400, 1, "I", ADC_ID)
        self._write(0x2010, 3, "B", COAST_SAMPLES)
        self.now += 0.01
        module.receive(Frame(NMT_ID, bytes([1, NODE])), self.now)

    def declare(self, declared: Declared) -> None:
        """Write the limits, as to a module in operation."""
        now = self.now
        per_cycle = TWO_PI / CYCLES_PER_REVOLUTION
        for subindex, kind, value in (
            (BAD_SAMPLES_SUBINDEX, "B", declared.bad),
            (PHASE_ERROR_SUBINDEX, "H", round(declared.phase_error * 65536)),
        ):
            if f"[2010sub{subindex:x}]" in _EDS:
                self._write(0x2010, subindex, kind, value)
        self._write(0x2010, 2, "f", declared.acceleration * per_cycle / INTERVAL_S**2)
        self.now = now

    def _write(self, index: int, subindex: int, kind: str, value: float) -> None:
        assert self.module is not None
        self.now += 1e-4
        self.module.receive(sdo_write(index, subindex, kind, value), self.now)

    def sync(self) -> list[tuple[float, int]]:
        self._number += 1
        payload = bytes([(self._number - 1) % 10 + 1])
        return self._receive(Frame(SYNC_ID, payload), 0.0)

    def sample(self, sine: int, cosine: int, flagged: bool) -> list[tuple[float, int]]:
        data = struct.pack("<hhB", sine, cosine, 2 * flagged)
        return self._receive(Frame(ADC_ID, data), PDO_LATER_S)

    def next(self) -> None:
        self.now += INTERVAL_S

    def _receive(self, frame: Frame, later_s: float) -> list[tuple[float, int]]:
        """Position, cycles, and status of each TPDO1 that the module sends up to and with this frame."""
        module: FeedbackModule | None = self.module
        assert module is not None
        now, sent = self.now + later_s, []
        while (due := module.deadline()) is not None and due <= now:
            sent += module.tick(due)
            if module.deadline() == due:
                break
        sent += module.receive(frame, now)
        return [_position(one.data) for one in sent if one.can_id == TPDO1_ID]


def _position(data: bytes) -> tuple[float, int]:
    position, status, _ = struct.unpack("<IHH", data)
    cycles = position / UNITS_PER_CYCLE
    return (cycles + RANGE_CYCLES / 2.0) % RANGE_CYCLES - RANGE_CYCLES / 2.0, status


class ModulePlayer:
    """Plays episodes of one machine; the module is reset by NMT between them."""

    def __init__(self, declared: Declared) -> None:
        self._declared = declared
        self._line = _Line()

    def play(self, episode: Episode) -> Published:
        """Through SYNC and PDO; ValueError for several samples for each SYNC."""
        if self._declared.samples_per_sync != 1:
            raise ValueError("on the module there is one sample for each SYNC")
        line, samples = self._line, len(episode.truth)
        line.power_on()
        hidden = HIDDEN_CYCLES * round(episode.speed / HIDDEN_CYCLES)
        shown = episode.truth - hidden * np.arange(samples)
        self._run_up(shown)
        line.declare(self._declared)
        position, status = np.zeros(samples), np.zeros(samples, np.int64)
        for k in range(samples):
            late = line.sync()
            if k and late and episode.state[k - 1] == State.MISSING:
                position[k - 1], status[k - 1] = late[-1]
            if episode.state[k] != State.MISSING:
                flagged = episode.state[k] == State.FLAGGED
                said = line.sample(int(episode.sine[k]), int(episode.cosine[k]), flagged)
                if said:
                    position[k], status[k] = said[-1]
            line.next()
        offset = round(float(shown[0] - position[0])) if status[0] & VALID else 0
        return Published(position + offset + hidden * np.arange(samples), status)

    def _run_up(self, shown: np.ndarray) -> None:
        """From rest to the first position of the episode, at its speed."""
        speed = float(shown[1] - shown[0])
        steps = math.ceil(abs(speed) / RAMP_CYCLES)
        speeds = np.concatenate((np.zeros(REST), np.linspace(0.0, speed, steps + 1), np.full(SETTLED, speed)))
        positions = shown[0] - np.cumsum(speeds[::-1])[::-1]
        sine, cosine = counts(positions, np.random.default_rng(0))
        for one in zip(sine.tolist(), cosine.tolist(), strict=True):
            self._line.sync()
            self._line.sample(*one, False)
            self._line.next()
