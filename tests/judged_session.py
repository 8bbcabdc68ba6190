"""What the first session of the README has to do in real time, whatever else the machine has to do.

Its example bridges a stall of HOLDS_MS, and the next one EVERY_S later: docs/time.md promises it. A busy
machine stalls for longer, or again before the position is back. Then the position may be lost, but never
valid and wrong. That it is kept is proven in simulated time, too (tests/cli/test_readme_commands.py).
"""

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass, field

from canfb import Frame, StatusBit
from canfb.cli.config_file import EXAMPLE
from canfb.configuration import Config, parse_config
from canfb.module.parameters import configured_defaults

TICK_S = 1e-7  # of 2000:05
MOST_WRONG_CYCLES = 0.5
EVERY_S = 1.5
HOLDS_MS = 50  # a shorter stall must not lose the position
BACK_S = 1.0  # and it is valid again so soon
PERIOD_S = 0.01
STALL_S = 2.0 * PERIOD_S
"""A longer pause between two frames of a node is a stall: one missed SYNC is none."""


class TrueMotion:
    """The position of the simulated machine at a sample time, modulo the range of 6004h, in its units."""

    def __init__(self, config: Config) -> None:
        module = config.modules[0]
        defaults = configured_defaults(module)
        self._motion = config.simulation.motion.motion()
        self._units, self.range = int(defaults[0x6001, 0]), int(defaults[0x6002, 0])
        self.units_per_cycle = self._units / module.cycles_per_revolution

    def at(self, machine_s: float) -> float:
        """Units at this time of the machine, which begins with its first sample."""
        return self._units * self._motion.revolutions(machine_s)


@dataclass
class Judge:
    """Takes the frames of a session in their order, and compares the positions with the true ones."""

    truth: TrueMotion
    module: int = 0x20
    interface: int = 0x10
    samples: int = 0
    valid: int = 0
    wrong: int = 0
    lost: bool = False
    longest_interval_s: float = 0.0
    longest_away_s: float = 0.0
    """From one valid position to the next."""
    _valid_at_s: float | None = None
    _last_ticks: int = 0
    _machine_s: float = 0.0
    _newest: float = math.inf
    _open: list[float] = field(default_factory=list)

    def take(self, can_id: int, data: bytes, at_s: float) -> None:
        """A frame that was received at ``at_s``, seconds."""
        if can_id == 0x180 + self.interface and len(data) == 8:
            self._sample(struct.unpack_from("<I", data, 4)[0])
        elif can_id == 0x180 + self.module and len(data) >= 6:
            units, status = struct.unpack_from("<IH", data)
            self._position(units, status, at_s)

    def take_all(self, frames: Iterable[Frame], at_s: float) -> None:
        """Frames of one instant."""
        for frame in frames:
            self.take(frame.can_id, frame.data, at_s)

    def _sample(self, ticks: int) -> None:
        if self.samples:
            interval_s = ((ticks - self._last_ticks) % 2**32) * TICK_S
            self.longest_interval_s = max(self.longest_interval_s, interval_s)
            self._machine_s += interval_s
        self._last_ticks = ticks
        self.samples += 1
        self._newest = self.truth.at(self._machine_s)
        self._open.append(self._newest)

    def _position(self, units: int, status: int, at_s: float) -> None:
        if status & StatusBit.LOST:
            self.lost = True
        if not status & StatusBit.VALID:
            return
        self.valid += 1
        if self._valid_at_s is not None:
            self.longest_away_s = max(self.longest_away_s, at_s - self._valid_at_s)
        self._valid_at_s = at_s
        # Positions come in the order of their samples; each belongs to one that has none yet.
        for place, true_units in enumerate(self._open):
            if self._is_right(units, true_units):
                del self._open[: place + 1]
                return
        self.wrong += not self._is_right(units, self._newest)  # that of a sample may be sent again

    def _is_right(self, units: int, true_units: float) -> bool:
        whole = self.truth.range
        difference = (units - true_units + whole / 2) % whole - whole / 2
        return abs(difference) < MOST_WRONG_CYCLES * self.truth.units_per_cycle


@dataclass
class SessionJudge(Judge):
    """It also sees what the machine did: pauses between the samples, and between the positions."""

    machine_held: bool = True
    """No stall was too long, or too close to the one before."""
    _last_s: dict[int, float] = field(default_factory=dict)
    _stalled_s: float = -math.inf

    def take(self, can_id: int, data: bytes, at_s: float) -> None:
        """A frame that was received at ``at_s``, seconds."""
        super().take(can_id, data, at_s)
        if can_id not in (0x180 + self.interface, 0x180 + self.module):
            return
        began_s = self._last_s.get(can_id, at_s)
        self._last_s[can_id] = at_s
        if at_s - began_s > STALL_S:
            again = self._stalled_s < began_s < self._stalled_s + EVERY_S
            self.machine_held &= at_s - began_s <= 1e-3 * HOLDS_MS and not again
            self._stalled_s = at_s


def new_judge() -> SessionJudge:
    """For a session with the example configuration; it must hear the first sample."""
    return SessionJudge(TrueMotion(parse_config(EXAMPLE)))


def check(judge: SessionJudge, said: str) -> None:
    """Never valid and wrong; on a machine that held, never lost, and soon valid again."""
    figures = f"{judge}\n{said}"
    assert judge.samples > 900, figures
    assert judge.wrong == 0, figures
    if judge.machine_held:
        assert not judge.lost, figures
        assert judge.valid > 0.5 * judge.samples, figures
        assert judge.longest_away_s < BACK_S + judge.longest_interval_s, figures
