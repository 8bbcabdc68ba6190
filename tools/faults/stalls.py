"""Stalls of the first session's programs, on a bus in real time: what the module makes of them.

    python -m tools.faults.stalls                      a minute and a half, on udp_multicast
    python -m tools.faults.stalls --full               every rate, duration and program, 60 s each
    python3 -m tools.vcan run -- .venv/bin/python -m tools.faults.stalls --channel vcan0

`canfb run` and `canfb simulate --rate` run as processes with the example configuration. SIGSTOP holds both,
or one of them, for some ten milliseconds, every one and a half seconds. Each valid position is compared with
the true one: the motion of the example at the sample time that the interface has sent with it. A run ends
when the position is lost. Exit status 1: a position was valid and wrong, or what must hold has not.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import can

from canfb.bus.opening import open_bus
from canfb.cli.config_file import EXAMPLE, EXAMPLE_BUS
from canfb.configuration import Config, parse_config
from canfb.hosting.trying import private_bus
from canfb.module.parameters import configured_defaults
from canfb.objects import StatusBit
from tools.running import canfb, running

NMT = 0x000
LOST = "position lost: "
CHANNEL = "stalls"  # in the logs
TICK_S = 1e-7  # of 2000:05
MOST_WRONG_CYCLES = 0.5
SETTLE_S, EVERY_S, READY_S = 5.0, 1.5, 120.0
HOLDS_MS = 50  # a shorter stall must not lose the position
BACK_S = 1.0  # and it is valid again so soon
STEADY_S = 0.25  # for so long; what is flagged later has another cause, as a load beside it
WHO = {"both": (0, 1), "module": (0,), "interface": (1,)}
DURATIONS_MS = (15, 20, 25, 30, 40, 50, 100)


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
    cause: str = ""
    """Of the loss, as `canfb run` says it."""
    longest_interval_s: float = 0.0
    longest_away_s: float = 0.0
    """From one valid position to the next."""
    back_s: list[float] = field(default_factory=list)
    """After each stall: how long the position was not valid, or not sent, from the end of the stall on."""
    _valid_at_s: float | None = None
    _last_ticks: int = 0
    _machine_s: float = 0.0
    _newest: float = math.inf
    _open: list[float] = field(default_factory=list)
    _resumed_s: float | None = None
    _back_at_s: float | None = None

    def take(self, can_id: int, data: bytes, at_s: float) -> None:
        """A frame that was received at ``at_s``, seconds."""
        if can_id == 0x180 + self.interface and len(data) == 8:
            self._sample(struct.unpack_from("<I", data, 4)[0])
        elif can_id == 0x180 + self.module and len(data) >= 6:
            units, status = struct.unpack_from("<IH", data)
            self._position(units, status, at_s)

    def resumed(self, at_s: float) -> None:
        """A stall has ended."""
        self.settle()
        self._resumed_s, self._back_at_s = at_s, None

    def settle(self) -> None:
        """Close the account of the last stall."""
        if self._resumed_s is not None:
            back_s = float("inf") if self._back_at_s is None else max(0.0, self._back_at_s - self._resumed_s)
            self.back_s.append(back_s)
        self._resumed_s = None

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
            if self._back_at_s is not None and at_s - self._back_at_s < STEADY_S:
                self._back_at_s = None
            return
        self.valid += 1
        if self._valid_at_s is not None:
            self.longest_away_s = max(self.longest_away_s, at_s - self._valid_at_s)
        self._valid_at_s = at_s
        if self._back_at_s is None and self._resumed_s is not None and at_s >= self._resumed_s:
            self._back_at_s = at_s
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


@dataclass(frozen=True)
class Run:
    """One run: SYNC rate, stalls of ``stall_ms`` of ``who`` (0: none), busy loops beside it."""

    rate_hz: float
    stall_ms: int
    who: str
    loops: int
    seconds: float


def measured(run: Run, words: dict[str, Any], log: Path | None = None) -> Judge:
    """Do it, with a bus log for `canfb log replay`. RuntimeError where a program does not start, or ends."""
    with contextlib.ExitStack() as held:
        folder = Path(held.enter_context(tempfile.TemporaryDirectory(prefix="canfb-stalls-")))
        path = folder / "feedback.yaml"
        path.write_text(EXAMPLE.replace(EXAMPLE_BUS, json.dumps(words)), encoding="utf-8")
        config = parse_config(path.read_text(encoding="utf-8"))
        judge = Judge(TrueMotion(config), config.modules[0].node_id, config.modules[0].encoder_interface)
        bus = held.enter_context(open_bus(config.bus))
        _deepen(bus)
        ready = [folder / "0.ready", folder / "1.ready"]
        commands = [
            canfb("run", str(path), "--ready-file", str(ready[0])),
            canfb("simulate", str(path), "--rate", f"{run.rate_hz:g}", "--ready-file", str(ready[1])),
        ]
        said = held.enter_context((folder / "run.txt").open("wb"))
        programs = [
            held.enter_context(running(commands[0], said)),
            held.enter_context(running(commands[1])),
        ]
        _wait_ready(ready, programs)
        for _ in range(run.loops):
            held.enter_context(running([sys.executable, "-c", "while True: pass"]))
        bus.send(can.Message(arbitration_id=NMT, data=b"\x01\x00", is_extended_id=False))
        writer = None if log is None else held.enter_context(can.Logger(log))
        _play(run, judge, bus, [programs[number] for number in WHO[run.who]], writer)
        if any(program.poll() is not None for program in programs):
            raise RuntimeError("a program of the session has ended")
        judge.settle()
        if judge.lost:
            programs[0].terminate()
            programs[0].wait(READY_S)
            lines = (folder / "run.txt").read_text(encoding="utf-8").splitlines()
            judge.cause = next((line.partition(LOST)[2] for line in lines if LOST in line), "")
    return judge


def _play(
    run: Run,
    judge: Judge,
    bus: can.BusABC,
    held: Sequence[subprocess.Popen[bytes]],
    writer: Callable[[can.Message], None] | None,
) -> None:
    began = time.monotonic()
    change_s, stopped = began + SETTLE_S, False
    while (now := time.monotonic()) < began + SETTLE_S + run.seconds and not (judge.lost and not stopped):
        if run.stall_ms and now >= change_s:
            for program in held:
                program.send_signal(signal.SIGCONT if stopped else signal.SIGSTOP)
            if stopped:
                judge.resumed(time.time())
            change_s = now + (EVERY_S if stopped else 1e-3 * run.stall_ms)
            stopped = not stopped
        end_s = change_s if run.stall_ms else now + 0.1
        message = bus.recv(min(0.1, max(0.0, end_s - now)))
        if message is not None:
            judge.take(message.arbitration_id, bytes(message.data), message.timestamp)
            if writer is not None:
                message.channel = CHANNEL  # udp_multicast has a name for each sender
                writer(message)
    for program in held:
        program.send_signal(signal.SIGCONT)


def _wait_ready(files: Sequence[Path], programs: Sequence[subprocess.Popen[bytes]]) -> None:
    deadline = time.monotonic() + READY_S
    while not all(file.exists() for file in files):
        if time.monotonic() > deadline or any(program.poll() is not None for program in programs):
            raise RuntimeError("the programs of the session do not start")
        time.sleep(0.05)


def _deepen(bus: can.BusABC) -> None:
    """A frame that this program drops would be a sample without a truth."""
    with contextlib.suppress(OSError, AttributeError), socket.socket(fileno=os.dup(bus.fileno())) as queue:
        queue.setsockopt(socket.SOL_SOCKET, getattr(socket, "SO_RCVBUFFORCE", 33), 1 << 22)


def runs_of(options: argparse.Namespace) -> list[Run]:
    """All runs that the options ask for."""
    return [
        Run(rate, stall, who, loops, options.seconds)
        for loops in options.loops
        for rate in options.rates
        for stall in options.stalls
        for who in (options.who if stall else ["both"])
    ]


def holds(run: Run, judge: Judge) -> bool:
    """Never valid and wrong; up to HOLDS_MS not lost, and valid again within BACK_S."""
    if judge.wrong or not judge.valid:
        return False
    return run.stall_ms > HOLDS_MS or not (judge.lost or any(back > BACK_S for back in judge.back_s))


def row(run: Run, judge: Judge) -> str:
    """One line of the table."""
    valid = f"{judge.valid} of {judge.samples}"
    stalled = f"{run.stall_ms} ms, {run.who}" if run.stall_ms else "none"
    back = max(judge.back_s, default=0.0)
    return (
        f"| {run.rate_hz:g} | {stalled} | {run.loops} | {len(judge.back_s)} | {valid} "
        f"| {judge.wrong} | {'lost' if judge.lost else 'kept'}{': ' * bool(judge.cause)}{judge.cause} "
        f"| {back:.2f} | {1e3 * judge.longest_interval_s:.0f} | {'yes' if holds(run, judge) else 'NO'} |"
    )


HEAD = """\
| Hz | stalls | loops | played | samples valid | wrong | position | back after, s | longest, ms | holds |
|---|---|---|---|---|---|---|---|---|---|"""


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The options."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.faults.stalls", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--channel", help="a SocketCAN interface, vcan0; without it, udp_multicast")
    parser.add_argument("--rates", type=float, nargs="+", metavar="HZ")
    parser.add_argument("--stalls", type=int, nargs="+", metavar="MS", help="0: none")
    parser.add_argument("--who", choices=WHO, nargs="+")
    parser.add_argument("--loops", type=int, nargs="+", metavar="N", help="busy loops beside it")
    parser.add_argument("--seconds", type=float, help="of each run, after 5 s from standstill")
    parser.add_argument("--full", action="store_true", help="all of them, 60 s each: some hours")
    parser.add_argument(
        "--logs", type=Path, metavar="FOLDER", help="keep the bus log of each run that does not hold"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object for each run")
    options = parser.parse_args(arguments)
    short = {
        "rates": [100.0],
        "stalls": [0, 15, 50],
        "who": ["both", "module"],
        "loops": [0],
        "seconds": 10.0,
    }
    full = {"rates": [100.0, 500.0], "stalls": [0, *DURATIONS_MS], "who": list(WHO), "loops": [0, 4]}
    defaults: dict[str, Any] = full | {"seconds": 60.0} if options.full else short
    for name, value in defaults.items():
        if getattr(options, name) is None:
            setattr(options, name, value)
    return options


def main(arguments: Sequence[str] | None = None) -> int:
    """Play the runs and print a line for each; 1 if one of them does not hold."""
    options = parse(arguments)
    held = True
    if options.logs is not None:
        options.logs.mkdir(parents=True, exist_ok=True)
    if not options.json:
        print(HEAD, flush=True)
    for number, run in enumerate(runs_of(options)):
        with contextlib.ExitStack() as stack:
            if options.channel is None:
                words = stack.enter_context(private_bus())
            else:
                words = {"interface": "socketcan", "channel": options.channel}
            log = None if options.logs is None else options.logs / f"{number}.log"
            judge = measured(run, words, log)
            if log is not None and holds(run, judge):
                log.unlink()
        held &= holds(run, judge)
        if options.json:
            figures: dict[str, Any] = {
                "samples": judge.samples,
                "valid": judge.valid,
                "wrong": judge.wrong,
                "lost": judge.lost,
                "cause": judge.cause,
            }
            figures |= {"back_s": judge.back_s, "longest_interval_s": judge.longest_interval_s}
            print(json.dumps(vars(run) | figures | {"holds": holds(run, judge)}), flush=True)
        else:
            print(row(run, judge), flush=True)
    return 0 if held else 1


if __name__ == "__main__":
    sys.exit(main())
