"""What the process asks of the system, and tells it: signals, scheduling, memory, processor, readiness."""

import contextlib
import ctypes
import errno
import gc
import os
import select
import signal
import socket
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from canfb.bus.runner import ending_on_signals, outside_collections
from canfb.configuration import RealtimeConfig
from canfb.errors import CanfbError, ConfigError
from canfb.hosting.readiness import Readiness
from canfb.hosting.realtime import MCL_CURRENT, MCL_FUTURE, RealtimeThread, apply_realtime
from folding import each
from processes import python

ENDINGS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@pytest.mark.parametrize("number", ENDINGS)
def test_a_signal_stops_and_the_handlers_before_come_back(number: signal.Signals) -> None:
    before = [signal.getsignal(one) for one in ENDINGS]
    stops: list[str] = []

    def failing() -> None:
        with ending_on_signals(lambda: stops.append("stop")):
            signal.raise_signal(number)
            signal.raise_signal(number)
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        failing()
    assert stops == ["stop", "stop"]
    assert [signal.getsignal(one) for one in ENDINGS] == before


def test_a_hangup_that_is_ignored_already_stays_so() -> None:
    """As nohup has it: the program outlives its terminal."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with ending_on_signals(lambda: pytest.fail("stopped")):
            signal.raise_signal(signal.SIGHUP)
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """What is asked of the system, which grants it."""
    calls: list[tuple[Any, ...]] = []

    def set_scheduler(thread: int, policy: int, parameters: os.sched_param) -> None:
        calls.append(("scheduler", thread, policy, parameters.sched_priority))

    def lock_memory(flags: int) -> int:
        calls.append(("mlockall", flags))
        return 0

    monkeypatch.setattr(os, "sched_setscheduler", set_scheduler)
    monkeypatch.setattr(os, "sched_setaffinity", lambda *call: calls.append(("affinity", *call)))
    monkeypatch.setattr(ctypes, "CDLL", lambda *name, **how: SimpleNamespace(mlockall=lock_memory))
    return calls


FIFO = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
LOCKED = ("mlockall", MCL_CURRENT | MCL_FUTURE)


@pytest.mark.parametrize(
    ("config", "calls"),
    [
        (
            RealtimeConfig(priority=80, lock_memory=True, cpu=3),
            [
                *(("scheduler", thread, FIFO, 80) for thread in (0, "cycle")),
                LOCKED,
                *(("affinity", thread, {3}) for thread in (0, "cycle")),
            ],
        ),
        # The thread would not run on the processor of a program that never sleeps.
        (RealtimeConfig(lock_memory=True, cpu=3, busy_poll=True), [LOCKED, ("affinity", 0, {3})]),
        (RealtimeConfig(cpu=0), [("affinity", 0, {0}), ("affinity", "cycle", {0})]),
        (RealtimeConfig(), []),
    ],
)
def test_the_process_and_a_thread_of_the_sync_cycle_get_what_is_asked_for(
    asked: list[tuple[Any, ...]], config: RealtimeConfig, calls: list[tuple[Any, ...]]
) -> None:
    over = threading.Event()
    threads = [RealtimeThread(target=over.wait), threading.Thread(target=over.wait)]
    for thread in threads:
        thread.start()
    try:
        apply_realtime(config, pytest.fail)
        named = {threads[0].native_id: "cycle"}
        assert [
            tuple(named.get(one, one) if n == 1 else one for n, one in enumerate(call)) for call in asked
        ] == calls
    finally:
        over.set()
        for thread in threads:
            thread.join()


PYTHON = os.path.realpath(sys.executable)
SETCAP = f"; sudo setcap {{}}+ep {PYTHON}, or {{}} in the systemd unit; see docs/service.md"
REMEDIES = (
    SETCAP.format("cap_sys_nice", "LimitRTPRIO=99"),
    SETCAP.format("cap_ipc_lock", "LimitMEMLOCK=infinity"),
)


WITHOUT_RIGHTS = """\
import ctypes, resource, sys
from canfb.hosting.realtime import apply_realtime
from canfb.configuration import RealtimeConfig
libc = ctypes.CDLL(None, use_errno=True)
header, none = (ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()
assert libc.capset(header, none) == 0, ctypes.get_errno()
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
resource.setrlimit(resource.RLIMIT_MEMLOCK, 2 * (int(sys.argv[1]),))
apply_realtime(RealtimeConfig(priority=80, lock_memory=True), print)
"""


@pytest.mark.parametrize("lockable_bytes", [0, 1 << 16])
def test_the_real_system_refuses_and_the_remedy_is_named(lockable_bytes: int) -> None:
    refused = os.strerror(errno.ENOMEM if lockable_bytes else errno.EPERM)
    assert python("-c", WITHOUT_RIGHTS, str(lockable_bytes)).stdout.splitlines() == [
        f"realtime: priority could not be set: {os.strerror(errno.EPERM)}{REMEDIES[0]}",
        f"realtime: lock_memory could not be set: {refused}{REMEDIES[1]}",
    ]


def test_what_the_real_system_does_not_have_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[str] = []
    before = os.sched_getaffinity(0)
    monkeypatch.delattr(os, "sched_setscheduler")
    apply_realtime(RealtimeConfig(priority=1, cpu=65535), lines.append)
    assert lines[0].startswith("realtime: priority could not be set: ")
    assert lines[1:] == ["realtime: cpu could not be set: Invalid argument"]
    assert os.sched_getaffinity(0) == before


def test_what_is_there_is_outside_of_collections_until_the_end() -> None:
    gc.unfreeze()
    with outside_collections():
        assert gc.get_freeze_count() > 1000
        assert len(gc.get_objects()) < 1000
    assert gc.get_freeze_count() == 0


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    """The socket of a service manager."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.bind(str(tmp_path / "notify"))
        one.setblocking(False)
        yield one


OF_ANOTHER = f"{os.getppid()}\n"


@pytest.mark.parametrize(
    ("left", "stays"), [(None, None), ("999999999\n", None), (OF_ANOTHER, OF_ANOTHER)], ids=str
)
def test_the_file_is_there_from_ready_to_the_end(tmp_path: Path, left: str | None, stays: str | None) -> None:
    """One that a killed program has left is removed, that of one that runs is replaced when ready."""
    path = tmp_path / "run.ready"
    if left is not None:
        path.write_text(left)
    for _ in range(2):  # the first leaves before it is ready
        with Readiness(path, environment={}) as readiness:
            assert (path.read_text() if path.exists() else None) == stays
    with readiness:
        readiness.ready()
        assert path.read_text() == f"{os.getpid()}\n"
        assert list(tmp_path.iterdir()) == [path], "nothing else is left there"
    assert not path.exists()


@each("name, content, reason", [
    *(
        ("feedback.yaml", text, r"feedback\.yaml: exists, and is not")
        for text in ("modules: []", "", "1\n2\n")
    ),
    ("no/such/folder", None, "No such file"),
    (".", None, "exists, and is not a ready file"),
])  # fmt: skip
def test_a_file_that_cannot_be_is_refused_at_the_start_and_another_is_not_touched(
    tmp_path: Path, name: str, content: str | None, reason: str
) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_text(content)
    with pytest.raises(ConfigError, match=reason), Readiness(path):
        pytest.fail("entered")
    assert content is None or path.read_text() == content


def test_who_waits_must_not_wait_for_ever(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    with Readiness(folder / "run.ready", environment={}) as readiness:
        folder.rmdir()
        with pytest.raises(CanfbError, match=r"run\.ready: No such file"):
            readiness.ready()


@pytest.mark.parametrize("abstract", [False, True])
def test_systemd_gets_ready_and_stopping(tmp_path: Path, abstract: bool) -> None:
    name = f"@canfb-{os.getpid()}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(name.replace("@", "\0"))
        manager.settimeout(10.0)
        with Readiness(environment={"NOTIFY_SOCKET": name}) as readiness:
            assert not select.select([manager], [], [], 0.0)[0]
            readiness.ready()
            assert manager.recv(100) == b"READY=1"
        assert manager.recv(100) == b"STOPPING=1"


def test_the_watchdog_of_systemd_hears_four_times_as_often_as_it_must(
    tmp_path: Path, manager: socket.socket
) -> None:
    environment = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "10000000"}
    readiness = Readiness(environment=environment | {"WATCHDOG_PID": str(os.getpid())})
    heard = 0
    for hundredth in range(3000):
        readiness.alive(0.01 * hundredth)
        with contextlib.suppress(BlockingIOError):
            assert manager.recv(100) == b"WATCHDOG=1"
            heard += 1
    assert heard == 12, "in 30 s"


@pytest.mark.parametrize(
    "watched",
    [{}, {"WATCHDOG_USEC": "1", "WATCHDOG_PID": "1"}, {"WATCHDOG_USEC": "soon"}, {"WATCHDOG_USEC": "0"}],
)
def test_nobody_watches(tmp_path: Path, manager: socket.socket, watched: dict[str, str]) -> None:
    readiness = Readiness(environment={"NOTIFY_SOCKET": str(tmp_path / "notify")} | watched)
    readiness.alive(1.0)
    with pytest.raises(BlockingIOError):
        manager.recv(100)


def test_a_service_manager_that_has_gone_is_a_line_and_no_more(tmp_path: Path) -> None:
    lines: list[str] = []
    environment = {"NOTIFY_SOCKET": str(tmp_path / "nobody")}
    with Readiness(report=lines.append, environment=environment) as readiness:
        readiness.ready()
    assert lines == [f"NOTIFY_SOCKET {tmp_path}/nobody: No such file or directory"] * 2
