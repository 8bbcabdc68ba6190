"""Which faults a replay had, and when."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import numpy as np

from canfb.objects import StatusBit
from canfb.replay.sample_columns import Block

KINDS = {
    "missed": StatusBit.MISSED,
    "residual": StatusBit.RESIDUAL,
    "amplitude": StatusBit.AMPLITUDE,
    "clipped": StatusBit.CLIPPED,
    "frozen": StatusBit.FROZEN,
    "coarse": StatusBit.COARSE,
    "second": StatusBit.SECOND_POSITION,
    "coasting": StatusBit.COASTING,
    "lost": StatusBit.LOST,
}
"""Kinds of faults, and the bit of the status word that shows each."""
MOST_LISTED = 1000
"""Of each kind; all are counted."""
EMERGENCY = struct.Struct("<HB")


@dataclass
class LoggedFault:
    """One that lasted for so many intervals: when it began and when it was last there (stamps, seconds)."""

    kind: str
    begin_s: float
    end_s: float
    samples: int


@dataclass(frozen=True)
class SentEmergency:
    """An EMCY of the replay: stamp of the log (seconds), error code, 1001h, and the manufacturer's bytes."""

    time_s: float
    code: int
    register: int
    manufacturer: bytes


@dataclass
class FaultList:
    """All faults of a replay.

    samples   intervals with this fault, by kind
    times     how often it began
    listed    the first :data:`MOST_LISTED` of each kind, in the order in which they begin
    """

    samples: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    times: dict[str, int] = field(default_factory=lambda: dict.fromkeys(KINDS, 0))
    listed: list[LoggedFault] = field(default_factory=list)
    emergencies: list[SentEmergency] = field(default_factory=list)
    emergencies_sent: int = 0
    _open: dict[str, LoggedFault] = field(default_factory=dict)

    def take(self, block: Block) -> None:
        """More intervals."""
        status, times = block["status"], block["time_s"]
        present = int(np.bitwise_or.reduce(status))
        for kind, bit in KINDS.items():
            if present & bit:
                self._take_kind(kind, status & bit != 0, times)
            else:
                self._open.pop(kind, None)

    def _take_kind(self, kind: str, there: np.ndarray, times: np.ndarray) -> None:
        self.samples[kind] += int(there.sum())
        steps = np.diff(there.astype(np.int8), prepend=0, append=0)
        begins, ends = np.flatnonzero(steps == 1), np.flatnonzero(steps == -1)
        carried = self._open.pop(kind, None)
        for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
            last_s = float(times[end - 1])
            if carried is not None and begin == 0:
                fault, fault_samples = carried, carried.samples
                fault.end_s, fault.samples = last_s, fault_samples + end
            else:
                fault = LoggedFault(kind, float(times[begin]), last_s, end - begin)
                self.times[kind] += 1
                if self.times[kind] <= MOST_LISTED:
                    self.listed.append(fault)
            if end == len(there):
                self._open[kind] = fault

    def emergency(self, data: bytes, time_s: float) -> None:
        """The module has sent an EMCY."""
        self.emergencies_sent += 1
        if len(data) == 8 and len(self.emergencies) < MOST_LISTED:
            code, register = EMERGENCY.unpack_from(data)
            self.emergencies.append(SentEmergency(time_s, code, register, data[3:]))

    def in_order(self) -> list[LoggedFault]:
        """The faults listed, as they began."""
        return sorted(self.listed, key=lambda fault: (fault.begin_s, fault.kind))
