"""Count how far one frame goes through the code: Python calls, and changes from file to file.

    python -m tools.bench.walk [--route NAME]

A call is a function, a lambda or a step of a generator in a file of canfb that begins to run; up to Python
3.11 also a comprehension. A change of file is a call or a return after which another file of canfb runs.
Frames come through the runner of `canfb run`: a walk begins when the bus has given the frame, and ends when
the bus is asked for the next one. --route prints every call of the walks with NAME in their name.
docs/architecture.md has the figures.
"""

from __future__ import annotations

import argparse
import math
import struct
import sys
from collections.abc import Iterable
from pathlib import Path
from types import FrameType
from typing import cast

# Names, not `canfb.FeedbackModule`: what is imported belongs to no walk.
import canfb
from canfb import CorrectionTable, FeedbackModule, ModuleConfig, StatusBit
from canfb.bus.frame_bus import FrameBus, Received
from canfb.bus.runner import Runner
from tools.bench.cycle import ADC_PDO, ENCODER_INTERFACE, INTERVAL_S, NODE_ID, SYNC
from tools.site.markdown import table

PACKAGE = Path(canfb.__file__).parent
SDO = 0x600 + NODE_ID
SETTLING = 2000  # SYNCs until nothing of the start is left
WALKED = 200
TABLE_STAGED = 0x2020, 1
TABLE_ENTRIES = 256
TICK_S = 1e-7  # of sample times (2000:05)


class Walk:
    """What runs in the files of ``folder`` between :meth:`begin` and :meth:`end`.

    ``calls``    Python calls
    ``changes``  calls and returns after which another file runs
    ``route``    each call: how deep, which file, which function
    """

    def __init__(self, folder: Path = PACKAGE) -> None:
        self._folder = f"{folder}/"
        self.changes = 0
        self.route: list[tuple[int, str, str]] = []
        self._file: str | None = None
        self._depth = 0

    @property
    def calls(self) -> int:
        return len(self.route)

    @property
    def files(self) -> int:
        return len({file for _, file, _ in self.route})

    def begin(self) -> None:
        """Begin in the file that runs now, if it is one of the folder."""
        self._file = self._running(sys._getframe(1))
        sys.setprofile(self._look)

    def end(self) -> None:
        sys.setprofile(None)

    def _look(self, frame: FrameType, event: str, argument: object) -> None:
        file = self._inside(frame)
        if file is None or event not in ("call", "return"):
            return
        if event == "call":
            self.route.append((self._depth, file, frame.f_code.co_qualname))
            self._depth += 1
        else:
            file = self._running(frame.f_back)
            self._depth = max(0, self._depth - 1)  # what ran before the walk may return
        if file is not None:
            self.changes += self._file not in (None, file)
            self._file = file

    def _inside(self, frame: FrameType) -> str | None:
        name = frame.f_code.co_filename
        return name.removeprefix(self._folder) if name.startswith(self._folder) else None

    def _running(self, frame: FrameType | None) -> str | None:
        """The innermost file of the folder that is being executed."""
        while frame is not None:
            if file := self._inside(frame):
                return file
            frame = frame.f_back
        return None


def usual(walks: list[Walk]) -> Walk:
    """The median by calls: now and then a frame looks further ahead."""
    return sorted(walks, key=lambda walk: (walk.calls, walk.changes))[len(walks) // 2]


class WalkedBus:
    """Hands out frames, and walks with those that have a name. Time stands still between them."""

    def __init__(self, frames: list[tuple[float, str, Received]]) -> None:
        self._frames = iter(frames)
        self._walk: Walk | None = None
        self.walks: dict[str, list[Walk]] = {}
        self.now = 0.0
        self.over = False

    def clock(self) -> float:
        return self.now

    def receive(self, wait_s: float) -> Received | None:
        if self._walk is not None:
            self._walk.end()
        self.now, name, frame = next(self._frames, (self.now, "", None))
        self.over = frame is None
        self._walk = Walk() if name else None
        if self._walk is not None:
            self.walks.setdefault(name, []).append(self._walk)
            self._walk.begin()
        return frame

    def send(self, can_id: int, data: bytes, remote: bool) -> bool:
        return True

    def accept(self, can_ids: Iterable[int] | None, remote_can_ids: Iterable[int]) -> None:
        pass


def planned_frames(crc32: int, times: bool) -> list[tuple[float, str, Received]]:
    """(time, name of its walk, frame): SYNCs and their ADC PDOs; 2020:03 before and after.

    With ``times`` each ADC PDO carries its sample time, and has the only walks.
    """
    adc_pdo = "ADC PDO with sample time" if times else "ADC PDO to position PDO"

    def planned(now: float, name: str, can_id: int, data: bytes = b"") -> tuple[float, str, Received]:
        return now, name, (can_id, data, now)

    activate = struct.pack("<BHBI", 0x23, 0x2020, 3, crc32)
    plan = [planned(0.0, "", SDO, activate)]
    for cycle in range(SETTLING + WALKED):
        now, walked = (cycle + 1) * INTERVAL_S, cycle >= SETTLING
        angle = 2.0 * math.pi * 0.3 * cycle
        tracks = struct.pack("<hh", round(1500 * math.sin(angle)), round(1500 * math.cos(angle)))
        if times:
            tracks += struct.pack("<I", round(now / TICK_S))
        plan.append(planned(now, "SYNC" * (walked and not times), SYNC))
        plan.append(planned(now + 0.2 * INTERVAL_S, adc_pdo * walked, ADC_PDO, tracks))
    if times:
        return plan
    return [*plan, *[planned(now + 0.4 * INTERVAL_S, "activation of a table", SDO, activate)] * 9]


def frames(times: bool = False) -> dict[str, Walk]:
    """The walks of frames through the runner and a module that turns with a table."""
    module = FeedbackModule(
        ModuleConfig(node_id=NODE_ID, encoder_interface=ENCODER_INTERFACE, autostart=True, times=times)
    )
    table = CorrectionTable.identity(TABLE_ENTRIES)
    bus = WalkedBus(planned_frames(table.crc32, times))
    runner = Runner(cast(FrameBus, bus), [module], clock=bus.clock, wall=bus.clock)
    runner.run(
        finished=lambda: bus.over,
        ready=lambda: module.dictionary.entry(*TABLE_STAGED).download(table.to_bytes()),
    )
    feedback = module.feedback
    if feedback is None or feedback.status != StatusBit.VALID | StatusBit.TABLE_ACTIVE:
        raise RuntimeError(f"the module does not call its samples valid: {feedback}")
    return {name: usual(walks) for name, walks in bus.walks.items()}


def all_walks() -> dict[str, Walk]:
    """Of a module without sample times, and of one with them."""
    return frames() | frames(times=True)


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench.walk", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument(
        "--route", metavar="NAME", help="print every call of the walks with this in their name"
    )
    options = parser.parse_args(arguments)
    walks = all_walks()
    if options.route is None:
        rows = [(name, walk.calls, walk.files, walk.changes) for name, walk in walks.items()]
        print("\n".join(table(("walk", "calls", "files", "changes of file"), rows)))
        return 0
    chosen = [walk for name, walk in walks.items() if options.route in name]
    if not chosen:
        parser.error(f"no walk has {options.route!r} in its name; there are: {', '.join(walks)}")
    for walk in chosen:
        for depth, file, function in walk.route:
            print(f"{file:<34}{'  ' * depth}{function}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
