"""Tests on a real SocketCAN interface: what they need, and what they may use.

Run them with `make socketcan`, or `python -m tools.vcan run -- .venv/bin/python -m pytest tests/socketcan`.
They wait for what happens on the bus, and every limit comes from what this machine can do: pace.py.
"""

import contextlib
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from network import OpenBus, skip_unless_required
from pace import Pace, measure

from preloaded import Preloaded
from processes import Started, commands

CHANNEL = "vcan0"
NO_VCAN = f"no SocketCAN interface {CHANNEL}; run: python -m tools.vcan run -- pytest tests/socketcan"
HERE = Path(__file__).parent
MEASURED = pytest.StashKey[Pace]()


def vcan_is_up() -> bool:
    flags = Path(f"/sys/class/net/{CHANNEL}/flags")
    return flags.exists() and bool(int(flags.read_text(), 16) & 1)


@pytest.hookimpl(tryfirst=True)  # before -m chooses
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    for item in items:
        if HERE in item.path.parents:
            item.add_marker(pytest.mark.socketcan)


def pytest_runtest_setup() -> None:
    if not vcan_is_up():
        skip_unless_required(NO_VCAN)


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    if MEASURED in config.stash:
        terminalreporter.write_line(str(config.stash[MEASURED]))


@pytest.fixture(scope="session")
def pace(request: pytest.FixtureRequest) -> Pace:
    """What this machine can do, measured once."""
    return request.config.stash.setdefault(MEASURED, measure(CHANNEL))


@pytest.fixture(scope="session")
def can_channel() -> str:
    return CHANNEL


@pytest.fixture
def can_utils() -> None:
    """For tests that use candump, cansend and their like."""
    if shutil.which("candump") is None:
        skip_unless_required("no can-utils; run: apt-get install can-utils")


@pytest.fixture(scope="session")
def preloaded() -> Iterator[Preloaded]:
    """What the commands of the project are forked from."""
    with Preloaded() as made:
        yield made


@pytest.fixture
def command(pace: Pace) -> Iterator[Started]:
    """Starts any command: command("candump", "-L", "vcan0"). All are ended after the test."""
    with commands(pace.patience_s) as start:
        yield start


@pytest.fixture
def process(pace: Pace, preloaded: Preloaded) -> Iterator[Started]:
    """Starts a command of the project: process("run", "module.yaml"). All are ended after the test."""
    with commands(pace.patience_s, preloaded.start) as start:
        yield start


@pytest.fixture(scope="module")
def lasting_process(pace: Pace, preloaded: Preloaded) -> Iterator[Started]:
    """The same for a process that serves all tests of a file."""
    with commands(pace.patience_s, preloaded.start) as start:
        yield start


@contextlib.contextmanager
def buses() -> Iterator[OpenBus]:
    """Opens python-can buses on the interface; all are closed afterwards."""
    with contextlib.ExitStack() as stack:

        def open_one(**options: Any) -> can.BusABC:
            bus = can.Bus(interface="socketcan", channel=CHANNEL, **options)
            stack.callback(bus.shutdown)
            return bus

        yield open_one


@pytest.fixture
def open_bus() -> Iterator[OpenBus]:
    """Opens python-can buses on the interface: open_bus(can_filters=...). All are closed after the test."""
    with buses() as open_one:
        yield open_one


@pytest.fixture
def can_bus(open_bus: OpenBus) -> can.BusABC:
    return open_bus()
