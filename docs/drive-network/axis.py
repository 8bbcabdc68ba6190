"""A CiA 402 drive from the master's side, over its PDOs: states, moves, and what came out of a move.

Needs python canopen. Positions are revolutions of the machine.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from canopen.profiles.p402 import State402

CYCLIC = 8  # 6060h: cyclic synchronous position
ENABLE, RESET_FAULT = 0x0F, 0x80
WINDOW = 1 / 8192  # revolutions: within it the target is reached
VALID = 1 << 0  # 2011:01 of the module
PATIENCE_S, MOVE_S = 20.0, 600.0  # for a step, for a whole move: a slow computer takes its time

NEXT = {
    "SWITCH ON DISABLED": "READY TO SWITCH ON",
    "READY TO SWITCH ON": "SWITCHED ON",
    "SWITCHED ON": "OPERATION ENABLED",
    "QUICK STOP ACTIVE": "SWITCH ON DISABLED",
}  # on the way to OPERATION ENABLED

Until = Callable[[Callable[[], bool], float, str], None]
"""Wait until it is true, with a limit in seconds, for what: raises when something goes wrong."""


class FaultError(Exception):
    """A node has a fault, is gone, or does not do what it should; one line."""


@dataclass(frozen=True)
class Row:
    """One SYNC: what the drive and the module have sent, revolutions.

    The drive shows what it knew at the SYNC: the position of the module from the cycle before, which is the
    last or the last but one that the master has heard.
    """

    state: str
    position: float
    demand: float
    following_error: float
    module_positions: tuple[float, float]
    module_valid: bool

    def apart(self, offset: float) -> float:
        """How far drive and module are apart; ``offset`` is that of their zero points."""
        return min(abs(one - offset - self.position) for one in self.module_positions)


@dataclass(frozen=True)
class Figures:
    """What came out of a move, revolutions and SYNCs."""

    following_rms: float
    following_peak: float
    settled_syncs: int
    drive: float
    module: float
    apart_peak: float


class Axis:
    """The drive ``drive`` with its feedback ``module``, two canopen.RemoteNode whose PDOs are set up.

    ``range_units`` is 6002h of the module: its position wraps there. ``until`` waits. Moves have this
    largest ``speed`` and ``acceleration``, revolutions per second and second squared.
    """

    def __init__(
        self,
        drive: Any,
        module: Any,
        range_units: int,
        until: Until,
        speed: float = 0.75,
        acceleration: float = 1.0,
    ) -> None:
        self._drive, self._module, self._until = drive, module, until
        self._range = range_units
        self._last_units: int | None = None
        self._module_units = self._module_before = 0
        self.units = int(drive.sdo[0x608F][1].raw) / int(drive.sdo[0x608F][2].raw)
        self.module_units = int(drive.sdo[0x60E6][1].raw) / int(drive.sdo[0x60EB][1].raw)
        self._speed, self._acceleration = speed, acceleration
        self.rows: list[Row] = []  # since the move has begun
        self.all_rows: list[Row] = []
        self.follow: Callable[[], float] | None = None  # the set-point for the next SYNC
        self._module_pdo = _pdo_with(module.tpdo, 0x6004, 0x2011)
        self._state_pdo = _pdo_with(drive.tpdo, 0x6041, 0x6061, 0x6064)
        self._loop_pdo = _pdo_with(drive.tpdo, 0x60F4, 0x6062)
        self._command_pdo = _pdo_with(drive.rpdo, 0x6040, 0x6060, 0x607A)
        self._module_pdo.add_callback(self._hear_module)
        self._loop_pdo.add_callback(self._hear_drive)  # the last one that the drive sends at a SYNC

    @property
    def state(self) -> str:
        """The state of the drive, as canopen names it: OPERATION ENABLED, FAULT, ..."""
        return _state(self._state_pdo[0x6041].raw)

    @property
    def position(self) -> float:
        """What the drive says."""
        return float(self._state_pdo[0x6064].raw / self.units)

    @property
    def module_status(self) -> int:
        """2011:01 of the last position PDO; the first of 2011h in its map."""
        return int(self._module_pdo[0x2011].raw)

    def feedback_is_steady(self) -> bool:
        """The position of the module was valid at the last 20 SYNCs."""
        return len(self.rows) >= 20 and all(row.module_valid for row in self.rows[-20:])

    def enable(self) -> None:
        """Through the states to OPERATION ENABLED, where the target is the present position."""
        self._until(lambda: len(self.rows) > 0, PATIENCE_S, "the drive to answer the SYNC")
        passing = ("NOT READY TO SWITCH ON", "FAULT REACTION ACTIVE")
        self._until(lambda: self.state not in passing, PATIENCE_S, "a state that can be left by command")
        self._command_pdo[0x6060].raw = CYCLIC
        if self.state == "FAULT":
            self.command(0)
            answered = len(self.rows)
            self._until(
                lambda: len(self.rows) > answered + 2, PATIENCE_S, "three SYNCs"
            )  # the reset is an edge
            self.command(RESET_FAULT)
            self._until(
                lambda: self.state != "FAULT", PATIENCE_S, "the end of the fault; is its cause still there?"
            )
        while (state := self.state) != "OPERATION ENABLED":
            aim = NEXT.get(state)
            if aim is None:
                raise FaultError(f"the drive is in {state}, from where no command leads on")
            self.command(State402.TRANSITIONTABLE[state, aim], self.position)
            self._running(lambda before=state: self.state != before, PATIENCE_S, aim)  # type: ignore[misc]
        self._running(lambda: self._state_pdo[0x6061].raw == CYCLIC, PATIENCE_S, f"mode {CYCLIC} (6061h)")

    def disable(self) -> None:
        """Switch the power stage off; no wait."""
        self.follow = None
        self.command(0)

    def command(self, controlword: int, target: float | None = None) -> None:
        """Send controlword, mode and target; the drive takes them at the next SYNC."""
        self._command_pdo[0x6040].raw = controlword
        if target is not None:
            self._command_pdo[0x607A].raw = round(target * self.units)
        self._command_pdo.transmit()

    def begin(self, distance: float) -> float:
        """Begin a move; its target."""
        self.rows.clear()
        start = self.position
        target = start + distance
        profile = trapezoid(distance, self._speed, self._acceleration)
        period = self._drive.sdo[0x60C2][1].raw * 10.0 ** self._drive.sdo[0x60C2][2].raw
        self.follow = lambda: start + profile(len(self.rows) * period)
        return target

    def finish(self, target: float) -> None:
        """Wait until the target is reached, and see it stay there for half a second of SYNCs."""
        self._running(lambda: self._demands(target), MOVE_S, "the end of the set-points")
        self.wait_syncs(50)
        self.follow = None

    def figures(self, start: float, target: float) -> Figures:
        """What came out of the move that has just ended."""
        rows = self.rows
        errors = [row.following_error for row in rows]
        ended = next(n for n, row in enumerate(rows) if abs(row.demand - target) <= 1.5 / self.units)
        outside = [n for n, row in enumerate(rows) if abs(row.position - target) > WINDOW]
        offset = rows[0].module_positions[1] - rows[0].position
        return Figures(
            math.sqrt(sum(error * error for error in errors) / len(errors)),
            max(abs(error) for error in errors),
            max(0, outside[-1] + 1 - ended) if outside else 0,
            rows[-1].position - start,
            rows[-1].module_positions[1] - offset - start,
            max(row.apart(offset) for row in rows),
        )

    def wait_syncs(self, count: int) -> None:
        """Wait for this many SYNCs that the drive has answered."""
        end = len(self.rows) + count
        self._running(lambda: len(self.rows) >= end, PATIENCE_S + count, "the drive to answer the SYNC")

    def _running(self, true: Callable[[], bool], seconds: float, what: str) -> None:
        """Wait while the drive has no fault."""

        def done() -> bool:
            state = self.state
            if state.startswith("FAULT"):
                raise FaultError(f"the drive is in {state}")
            return true()

        self._until(done, seconds, what)

    def write_trace(self, path: str) -> None:
        """Everything as a table, a line for each SYNC; OSError if the file cannot be written."""
        with open(path, "w", newline="", encoding="utf-8") as file:
            table = csv.writer(file)
            table.writerow(
                ("sync", "state", "demand", "position", "following_error", "module", "module_valid")
            )
            for number, row in enumerate(self.all_rows):
                figures = (row.demand, row.position, row.following_error, row.module_positions[1])
                numbers = [f"{figure:.7f}" for figure in figures]
                table.writerow((number, row.state, *numbers, int(row.module_valid)))

    def _demands(self, target: float) -> bool:
        return bool(self.rows) and abs(self.rows[-1].demand - target) <= 1.5 / self.units

    def _hear_module(self, pdo: Any) -> None:
        units, last = int(pdo[0x6004].raw), self._last_units
        step = 0 if last is None else (units - last + self._range // 2) % self._range - self._range // 2
        self._module_before = self._module_units
        self._module_units += units if last is None else step
        self._last_units = units

    def _hear_drive(self, pdo: Any) -> None:
        row = Row(
            self.state,
            self.position,
            pdo[0x6062].raw / self.units,
            pdo[0x60F4].raw / self.units,
            (self._module_before / self.module_units, self._module_units / self.module_units),
            bool(self.module_status & VALID),
        )
        self.rows.append(row)
        self.all_rows.append(row)
        if self.follow is not None:
            self.command(ENABLE, self.follow())


def trapezoid(distance: float, speed: float, acceleration: float) -> Callable[[float], float]:
    """Position of a move from rest to rest as a function of time, s; all in one unit, speeds positive."""
    way, sign = abs(distance), math.copysign(1.0, distance)
    speed = min(speed, math.sqrt(way * acceleration))
    ramp = speed / acceleration
    total = ramp + (way / speed if speed else 0.0)

    def at(time: float) -> float:
        time = min(max(time, 0.0), total)
        if time < ramp:
            gone = 0.5 * acceleration * time * time
        elif time < total - ramp:
            gone = 0.5 * speed * ramp + speed * (time - ramp)
        else:
            gone = way - 0.5 * acceleration * (total - time) ** 2
        return sign * gone

    return at


def _pdo_with(pdos: Any, *indices: int) -> Any:
    """The PDO in use that carries all these objects."""
    for pdo in pdos.values():
        if pdo.enabled and set(indices) <= {variable.index for variable in pdo.map}:
            return pdo
    wanted = ", ".join(f"{index:04X}h" for index in indices)
    raise FaultError(f"no link of the network file carries {wanted} together")


def _state(statusword: int) -> str:
    masks = State402.SW_MASK.items()
    return next((name for name, (mask, bits) in masks if statusword & mask == bits), "UNKNOWN")
