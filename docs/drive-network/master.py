"""The master of the drive network: configures every node from network.yaml, runs a move, reports.

    python master.py network.yaml                     one revolution in profile position mode
    python master.py network.yaml --mode csp          the same, with a set-point at each SYNC
    python master.py network.yaml --provoke-alarm     the feedback fails in the middle of a move
    python master.py network.yaml --check             only compare; nothing is written, nothing moves

Exit status: 0 done, 1 a node is missing, refuses, differs or has a fault, 2 the network file is wrong.
Needs python canopen and pyyaml; the files beside it come along.
"""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

import can
import canopen
from axis import CYCLIC, PROFILE, VALID, Axis, FaultError
from configuring import Configuration, NetworkError
from network_file import NetworkFile, NetworkFileError, load

MODES = {"profile": PROFILE, "csp": CYCLIC}
LOOK_S = 0.002
SYNC, HEARTBEAT, OPERATIONAL = 0x80, 0x700, 5
BRAKING_S = 1.0  # until the machine stands: the module begins at standstill, and nobody sees the machine now
MISSED_HEARTBEATS = 5  # of a node, before the master calls it lost
ERRORS = {
    0x0000: "no error any more",
    0x7300: "sensor",
    0x7305: "feedback not valid or missing",
    0x7320: "position that cannot be",
    0x8100: "communication",
    0x8130: "heartbeat of another node lost",
    0x8611: "following error",
    0x8700: "no SYNC",
}  # what canopen has no words for


class Master:
    """Starts the nodes, produces SYNC and heartbeat, watches everybody. Leaves all PRE-OPERATIONAL.

    ``clock`` and ``wait`` are those of the system, but for tests.
    """

    def __init__(
        self,
        network: canopen.Network,
        file: NetworkFile,
        remotes: dict[str, Any],
        clock: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
    ) -> None:
        self._network, self._file, self._remotes = network, file, remotes
        self._clock, self.wait = clock, wait
        self._heard: dict[str, tuple[float, int]] = {}  # time and state of the last heartbeat
        self._emergencies: list[str] = []
        self._tasks: list[Any] = []
        self.on_duty: set[str] = set()  # who must be OPERATIONAL
        for name, remote in remotes.items():
            remote.nmt.add_heartbeat_callback(lambda state, name=name: self._hear(name, state))
            remote.emcy.add_callback(lambda error, name=name: self._note(name, error))
            self._listen(name, remote)

    def start(self) -> None:
        """Heartbeat and SYNC of the master, then the nodes one by one."""
        master = self._file.master_id
        if self._file.master_heartbeat_ms:
            beat = self._file.master_heartbeat_ms / 1000
            self._tasks.append(self._network.send_periodic(HEARTBEAT + master, bytes([OPERATIONAL]), beat))
        self._tasks.append(self._network.send_periodic(SYNC, b"", self._file.sync_period_us / 1e6))
        for name in self._file.nodes:
            self.start_node(name)
        print(f"started: {', '.join(self._file.nodes)}")

    def start_node(self, name: str) -> None:
        """NMT start, and wait for the heartbeat that says so."""
        self._remotes[name].nmt.state = "OPERATIONAL"
        if self._file.nodes[name].heartbeat_ms:
            self.until(lambda: self._state(name) == OPERATIONAL, 5.0, f"{name} to become OPERATIONAL")
            self.on_duty.add(name)

    def stop_node(self, name: str, state: str) -> None:
        """Take a node out of OPERATIONAL: STOPPED or PRE-OPERATIONAL."""
        self.on_duty.discard(name)
        self._remotes[name].nmt.state = state
        self._heard.pop(name, None)

    def close(self) -> None:
        """All nodes PRE-OPERATIONAL, drives first; no SYNC, no heartbeat any more."""
        with contextlib.suppress(can.CanError, OSError):  # the bus may be what has failed
            for name in reversed(list(self._file.nodes)):
                self.stop_node(name, "PRE-OPERATIONAL")
        for task in self._tasks:
            task.stop()
        self._tasks.clear()
        self._report_emergencies()

    def until(self, true: Callable[[], bool], seconds: float, what: str) -> None:
        """Wait for ``what``; FaultError when it does not come, or when a node fails meanwhile."""
        end = self._clock() + seconds
        while not true():
            self._report_emergencies()
            self._check_nodes()
            self._network.check()  # raises when the bus has failed
            if self._clock() > end:
                raise FaultError(f"waited {seconds:g} s for {what}")
            self.wait(LOOK_S)

    def _check_nodes(self) -> None:
        for name in self.on_duty:
            heard, state = self._heard[name]
            node = self._file.nodes[name]
            if self._clock() - heard > MISSED_HEARTBEATS * node.heartbeat_ms / 1000:
                raise FaultError(f"{node}: no heartbeat any more")
            if state != OPERATIONAL:
                raise FaultError(f"{node}: no longer OPERATIONAL, NMT state {state}")

    def _state(self, name: str) -> int:
        return self._heard.get(name, (0.0, 0))[1]

    def _hear(self, name: str, state: int) -> None:
        self._heard[name] = (self._clock(), state)

    def _note(self, name: str, error: Any) -> None:
        meaning = ERRORS.get(error.code) or error.get_desc() or "see its manual"
        self._emergencies.append(f"  EMCY of {self._file.nodes[name]}: {error.code:04X}h, {meaning}")

    def _report_emergencies(self) -> None:
        while self._emergencies:
            print(self._emergencies.pop(0))

    def _listen(self, name: str, remote: Any) -> None:
        """Give canopen the PDOs of the file, so that it need not read them from the nodes."""
        for pdo in self._file.nodes[name].pdos.values():
            if pdo.cob_id is None:
                continue
            known = (remote.tpdo if pdo.is_tpdo else remote.rpdo)[pdo.number]
            known.clear()
            for entry in pdo.mapping:
                known.add_variable(entry >> 16, entry >> 8 & 0xFF, entry & 0xFF)
            known.cob_id, known.enabled, known.trans_type = pdo.cob_id, True, pdo.kind
            if pdo.is_tpdo:
                known.subscribe()


class Story:
    """A move, and what the drive does when its feedback fails."""

    def __init__(self, master: Master, axis: Axis, mode: int, period_s: float) -> None:
        self._master, self._axis, self._mode, self._period_s = master, axis, mode, period_s

    def move(self, revolutions: float) -> list[str]:
        """Enable the drive and turn by so much; the report."""
        axis = self._axis
        axis.enable(self._mode)
        start = axis.position
        target = axis.begin(self._mode, revolutions)
        axis.finish(self._mode, target)
        result = axis.figures(start, target)
        settled_s = result.settled_syncs * self._period_s
        return [
            f"moved by {revolutions:g} revolutions in {len(axis.rows)} SYNCs; all figures in revolutions",
            f"  following error   rms {result.following_rms:.6f}, peak {result.following_peak:.6f}",
            f"  settled           {settled_s:.3f} s after the last set-point, within {axis.window:.6f}",
            f"  position          drive {result.drive:.6f}, module {result.module:.6f}",
            f"  drive and module  at most {result.apart_peak:.6f} apart at one SYNC",
        ]

    def provoke_alarm(self, revolutions: float) -> list[str]:
        """Stop the encoder interface in the middle of a move; the drive must go to FAULT."""
        axis, master = self._axis, self._master
        axis.enable(self._mode)
        start = axis.position
        axis.begin(self._mode, revolutions)
        axis.wait_syncs(2)
        master.until(lambda: abs(axis.position - start) > abs(revolutions) / 2, 60.0, "half of the way")
        stopped = len(axis.rows)
        master.stop_node("interface", "STOPPED")
        master.until(lambda: axis.state == "FAULT", 5.0, "the drive to go to FAULT")
        axis.follow = None
        rows = axis.rows[stopped:]
        unseen = sum(1 for row in rows if row.module_valid)
        running = sum(1 for row in rows if row.state == "OPERATION ENABLED")
        return [
            "alarm: the encoder interface was stopped in the middle of a move",
            f"  module            position not valid {unseen} SYNC(s) later",
            f"  drive             left OPERATION ENABLED {running} SYNC(s) later, is in FAULT",
        ]

    def recover(self) -> None:
        """Bring the feedback back: it counts anew from here, so a real machine must be homed now."""
        master, axis = self._master, self._axis
        master.wait(BRAKING_S)
        master.stop_node("module", "PRE-OPERATIONAL")
        master.start_node("interface")
        master.start_node("module")
        master.until(lambda: bool(axis.module_status & VALID), 5.0, "a valid position")


def main(arguments: list[str] | None = None) -> int:
    """The command."""
    options = parse(arguments)
    try:
        file = load(options.file)
    except NetworkFileError as error:
        print(f"master: {error}", file=sys.stderr)
        return 2
    network = canopen.Network()
    try:
        network.connect(**file.bus)
        return run(network, file, options)
    except (NetworkError, FaultError, can.CanError, OSError) as error:
        print(f"master: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("master: ended by a signal; the nodes are PRE-OPERATIONAL", file=sys.stderr)
        return 1
    finally:
        if network.bus is not None:
            network.disconnect()


def run(
    network: canopen.Network,
    file: NetworkFile,
    options: argparse.Namespace,
    clock: Callable[[], float] = time.monotonic,
    wait: Callable[[float], None] = time.sleep,
) -> int:
    """On a connected network: configure, start, move, leave all nodes PRE-OPERATIONAL."""
    configuration = Configuration(network, file)
    configuration.check_identity()
    print(f"found as expected: {', '.join(map(str, file.nodes.values()))}")
    if options.check:
        differences = configuration.compare()
        print("\n".join(differences) or "everything is as the file says")
        return 1 if differences else 0
    print(f"configured: {configuration.apply()} object(s) written, all read back")
    master = Master(network, file, configuration.remotes, clock, wait)
    try:
        try:
            master.start()
        except BaseException:
            configuration.undo()
            raise
        tell_story(master, file, configuration.remotes, options)
    finally:
        master.close()
    return 0


def tell_story(
    master: Master, file: NetworkFile, remotes: dict[str, Any], options: argparse.Namespace
) -> None:
    """The moves, and the alarm in between when it is wanted."""
    drive, module = remotes["drive"], remotes["module"]
    axis = Axis(drive, module, module.sdo[0x6002].raw, master.until)
    story = Story(master, axis, MODES[options.mode], file.sync_period_us / 1e6)
    try:
        print(*story.move(options.revolutions), sep="\n")
        if options.provoke_alarm:
            print(*story.provoke_alarm(options.revolutions), sep="\n")
            story.recover()
            print("recovered: the position is valid and counts anew; the fault is reset, and back again")
            print(*story.move(-options.revolutions), sep="\n")
    finally:
        with contextlib.suppress(can.CanError, OSError):
            axis.disable()
        master.wait(3 * file.sync_period_us / 1e6)  # the drive takes it at a SYNC


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command."""
    parser = argparse.ArgumentParser(prog="master", description="the master of the drive network")
    parser.add_argument("file", nargs="?", default="network.yaml")
    parser.add_argument("--mode", choices=MODES, default="profile")
    parser.add_argument("--revolutions", type=float, default=1.0, metavar="N")
    parser.add_argument("--provoke-alarm", action="store_true", help="the feedback fails in a move")
    parser.add_argument("--check", action="store_true", help="only compare")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does: nothing goes on turning
    sys.exit(main())
