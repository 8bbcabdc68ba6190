"""The master of the drive network: configures every node from network.yaml, runs a move, reports.

    python master.py network.yaml                     one revolution, with a set-point at each SYNC
    python master.py network.yaml --provoke-alarm     the feedback fails in the middle of a move
    python master.py network.yaml --check             only compare; nothing is written, nothing moves

Exit status: 0 done, 1 a node is missing, refuses, differs or has a fault, 2 the network file is wrong.
Needs python canopen and pyyaml; the files beside it come along.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import signal
import sys
import time
from collections.abc import Callable
from typing import Any

import can
import canopen
from axis import MOVE_S, PATIENCE_S, WINDOW, Axis, FaultError
from canopen.sdo.exceptions import SdoError
from configuring import Configuration, NetworkError
from network_file import NetworkFile, NetworkFileError, load
from nodes import Listener, Nodes
from sync import produce

BRAKING_S = 1.0  # until the machine stands: the module begins at standstill, and nobody sees the machine now
STEADY_S = 1.0  # for the feedback, until it is taken for lost


class Story:
    """A move, and what the drive does when its feedback fails."""

    def __init__(self, nodes: Nodes, axis: Axis, configuration: Configuration, period_s: float) -> None:
        self._nodes, self._axis, self._configuration = nodes, axis, configuration
        self._period_s = period_s

    def move(self, revolutions: float) -> list[str]:
        """Enable the drive and turn by so much; the report."""
        axis = self._axis
        self._pass(STEADY_S, axis.feedback_is_steady)
        if not axis.feedback_is_steady():
            self.recover()  # it began while the machine was still turning
        axis.enable()
        start = axis.position
        target = axis.begin(revolutions)
        axis.finish(target)
        result = axis.figures(start, target)
        settled_s = result.settled_syncs * self._period_s
        return [
            f"moved by {revolutions:g} revolutions in {len(axis.rows)} SYNCs; all figures in revolutions",
            f"  following error   rms {result.following_rms:.6f}, peak {result.following_peak:.6f}",
            f"  settled           {settled_s:.3f} s after the last set-point, within {WINDOW:.6f}",
            f"  position          drive {result.drive:.6f}, module {result.module:.6f}",
            f"  drive and module  at most {result.apart_peak:.6f} apart at one SYNC",
        ]

    def provoke_alarm(self, revolutions: float) -> list[str]:
        """Stop the encoder interface in the middle of a move; the drive must go to FAULT."""
        axis, nodes = self._axis, self._nodes
        axis.enable()
        start = axis.position
        axis.begin(revolutions)
        axis.wait_syncs(2)
        nodes.until(lambda: abs(axis.position - start) > abs(revolutions) / 2, MOVE_S, "half of the distance")
        stopped = len(axis.rows)
        nodes.stop_node("interface", "STOPPED")
        nodes.until(lambda: axis.state == "FAULT", PATIENCE_S, "the drive to go to FAULT")
        axis.follow = None
        rows = axis.rows[stopped:]
        unseen = sum(1 for row in rows if row.module_valid)
        running = sum(1 for row in rows if row.state == "OPERATION ENABLED")
        return [
            "alarm: the encoder interface was stopped in the middle of a move",
            f"  module            position not valid {unseen} SYNC(s) later",
            f"  drive             left OPERATION ENABLED {running} SYNC(s) later, is in FAULT",
        ]

    def _pass(self, seconds: float, enough: Callable[[], bool] = lambda: False) -> None:
        """Let so much time of the SYNC pass, or less when it is enough."""
        end = len(self._axis.all_rows) + seconds / self._period_s
        self._nodes.until(
            lambda: enough() or len(self._axis.all_rows) >= end, MOVE_S, "the drive to answer the SYNC"
        )

    def recover(self) -> None:
        """Reset the feedback at standstill. It counts from here: home a real machine now."""
        nodes, axis = self._nodes, self._axis
        self._pass(BRAKING_S)
        nodes.reset_node("module")
        self._configuration.apply_to("module")
        nodes.start_nodes()
        axis.rows.clear()
        nodes.until(axis.feedback_is_steady, PATIENCE_S, "a valid position")


def main(arguments: list[str] | None = None) -> int:
    """The command."""
    options = parse(arguments)
    logging.getLogger("canopen").addHandler(logging.NullHandler())  # its messages are printed here, too
    try:
        file = load(options.file)
    except NetworkFileError as error:
        print(f"master: {error}", file=sys.stderr)
        return 2
    network = canopen.Network()
    try:
        network.listeners = [Listener(network)]
        network.connect(**file.bus)
        return run(network, file, options)
    except (NetworkError, FaultError, SdoError, can.CanError, OSError) as error:
        print(f"master: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("master: ended by a signal; the nodes are PRE-OPERATIONAL", file=sys.stderr)
        return 1
    finally:
        with contextlib.suppress(can.CanError, OSError):  # already reported
            if network.bus is not None:
                network.disconnect()


def run(
    network: canopen.Network,
    file: NetworkFile,
    options: argparse.Namespace,
    clock: Callable[[], float] = time.monotonic,
    wait: Callable[[float], None] = time.sleep,
    sync: Callable[[canopen.Network, NetworkFile], Any] = produce,
) -> int:
    """On a connected network: configure, start, move, leave all nodes PRE-OPERATIONAL."""
    configuration = Configuration(network, file)
    configuration.check_identity()
    print(f"found as expected: {', '.join(map(str, file.nodes.values()))}")
    if options.check:
        differences = configuration.compare()
        print("\n".join(differences) or "all nodes agree with the file")
        return 1 if differences else 0
    print(f"configured: {configuration.apply()} object(s) written, all read back")
    nodes = Nodes(network, file, configuration.remotes, clock, wait, sync)
    try:
        try:
            nodes.start()
        except BaseException:
            nodes.close()
            configuration.undo()
            raise
        tell_story(nodes, file, configuration, options)
    finally:
        nodes.close()
    return 0


def tell_story(
    nodes: Nodes, file: NetworkFile, configuration: Configuration, options: argparse.Namespace
) -> None:
    """The moves, with an alarm in between if requested."""
    remotes = configuration.remotes
    missing = {"interface", "module", "drive"} - set(remotes)
    if missing:
        raise FaultError(f"this example needs nodes with the names {', '.join(sorted(missing))}")
    drive, module = remotes["drive"], remotes["module"]
    axis = Axis(drive, module, module.sdo[0x6002].raw, nodes.until, options.speed, options.acceleration)
    story = Story(nodes, axis, configuration, file.sync_period_us / 1e6)
    try:
        print(*story.move(options.revolutions), sep="\n")
        if options.provoke_alarm:
            print(*story.provoke_alarm(options.revolutions), sep="\n")
            story.recover()
            print("recovered: the position is valid, counted from zero; the fault is reset; moving back")
            print(*story.move(-options.revolutions), sep="\n")
    finally:
        with contextlib.suppress(can.CanError, OSError):
            axis.disable()
        nodes.wait(3 * file.sync_period_us / 1e6)  # the drive takes it at a SYNC
        if options.trace:
            axis.write_trace(options.trace)


def parse(arguments: list[str] | None) -> argparse.Namespace:
    """The options of the command."""
    parser = argparse.ArgumentParser(prog="master", description="the master of the drive network")
    parser.add_argument("file", nargs="?", default="network.yaml")
    parser.add_argument("--revolutions", type=float, default=1.0, metavar="N")
    parser.add_argument("--speed", type=float, default=0.75, metavar="V", help="revolutions per second")
    parser.add_argument("--acceleration", type=float, default=1.0, metavar="A", help="revolutions/s^2")
    parser.add_argument("--provoke-alarm", action="store_true", help="let the feedback fail during a move")
    parser.add_argument("--trace", metavar="FILE.csv", help="values received at each SYNC, in revolutions")
    parser.add_argument("--check", action="store_true", help="only compare")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends as Ctrl-C does: nothing goes on turning
    sys.exit(main())
