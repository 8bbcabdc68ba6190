"""Settings for all tests, and a bus for those with several processes."""

import contextlib
import gc
import os
import signal
import socket
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import can
import canopen
import canopen.node.base
import pytest
from hypothesis import HealthCheck, settings

from canfb.bus.opening import open_bus
from canfb.errors import BusError

# No deadlines, nor a limit on the time of drawing: a loaded machine is no finding. CI draws the same examples
# each time, so that a run can be repeated, and a quarter of the usual 100, to be through in a quarter of an
# hour; elsewhere they are random, others in each run, and half of them.
UNTIMED = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("default", UNTIMED, max_examples=50)
settings.register_profile("ci", UNTIMED, derandomize=True, max_examples=25)
settings.register_profile("check", UNTIMED, derandomize=True, max_examples=5)  # make check
settings.load_profile("ci" if os.environ.get("CI") else "default")


signal.signal(signal.SIGHUP, lambda number, frame: None)  # nohup ignores it, and so would each command
os.environ["XDG_CONFIG_HOME"] = "/no-such-folder"  # no default bus of the user
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # more wait for each other where tests run side by side
for _name in ("NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"):
    os.environ.pop(_name, None)  # nor does a service manager hear of them


class _Frozen:
    """What has been imported and collected stays: the garbage collector does not look at it again.

    A full collection over what the whole suite has there takes 0.24 s, in each test that makes many objects;
    those of the young objects alone, by default each 700 of them, take a tenth of all processor time.
    """

    def __init__(self) -> None:
        self._unfreeze = gc.unfreeze
        self._is_frozen = False
        gc.unfreeze = self.unfreeze

    def freeze(self) -> None:
        if not self._is_frozen:
            gc.freeze()
            self._is_frozen = True

    def unfreeze(self) -> None:
        """A module that ends unfreezes all (canfb.hosting.realtime): until the next test."""
        self._unfreeze()
        self._is_frozen = False


_frozen = _Frozen()
gc.set_threshold(50_000, 50, 100)


def pytest_runtest_setup() -> None:
    _frozen.freeze()


@pytest.hookimpl(tryfirst=True)  # before `-m "not long"` chooses
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what `make check` leaves out: one name of a test a line, whatever its parameters and its file."""
    long = set(Path(__file__).with_name("long_tests.txt").read_text(encoding="ascii").splitlines())
    for item in items:
        if item.nodeid.partition("::")[2].partition("[")[0] in long:
            item.add_marker("long")


@cache
def _parsed(path: str, written_ns: int, node_id: int | None) -> Any:
    return canopen.objectdictionary.import_od(path, node_id)


def _import_od(source: Any, node_id: int | None = None) -> Any:
    """Let python canopen parse each EDS once: half of the time of a small test. Nobody writes to it."""
    if not isinstance(source, str) or not source.endswith(".eds"):
        return canopen.objectdictionary.import_od(source, node_id)
    return _parsed(source, os.stat(source).st_mtime_ns, node_id)


canopen.import_od = canopen.node.base.import_od = _import_od


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str]) -> Any:
    """Runs `canfb ...`: command("plan --rpm 3000", path, code=1).lines."""
    from commands import Command  # loads the commands: most tests need none

    return Command(capsys)


@pytest.fixture
def canfb(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    from node_commands import Commands

    return Commands(monkeypatch, capsys)


@pytest.fixture
def started() -> Iterator[Any]:
    """Starts any command as a process: started("candump", "vcan0"). All are ended after the test."""
    from processes import commands  # most tests need none

    with commands(120.0) as start:
        yield start


@pytest.fixture
def multicast_words() -> dict[str, Any]:
    """A multicast bus on a port that nobody uses: tests side by side have buses of their own."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("", 0))
        port = int(free.getsockname()[1])
    # No hop: what the test sends stays on this machine.
    return {"interface": "udp_multicast", "channel": "239.74.163.2", "port": port, "hop_limit": 0}


@pytest.fixture
def multicast_bus(multicast_words: dict[str, Any]) -> Iterator[can.BusABC]:
    """The bus of the master; skips where multicast does not work."""
    with contextlib.ExitStack() as stack:
        try:
            bus, probe = (stack.enter_context(open_bus(multicast_words)) for _ in range(2))
            probe.send(can.Message(arbitration_id=0x7F0, is_extended_id=False))
            heard = bus.recv(2.0)
        except (BusError, can.CanError) as error:
            pytest.skip(f"no multicast on this machine: {error}")
        if heard is None or heard.arbitration_id != 0x7F0:
            pytest.skip("no multicast on this machine: a datagram did not arrive")
        probe.shutdown()
        yield bus
