"""What tells others that a program is on its bus."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from canfb.errors import CanfbError, ConfigError
from canfb.hosting.readiness import Readiness


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    """The socket of a service manager."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.bind(str(tmp_path / "notify"))
        one.setblocking(False)
        yield one


@pytest.mark.parametrize("left_by_a_killed_program", [None, "999999999\n"])
def test_the_file_is_there_from_ready_to_the_end(
    tmp_path: Path, left_by_a_killed_program: str | None
) -> None:
    path = tmp_path / "run.ready"
    if left_by_a_killed_program is not None:
        path.write_text(left_by_a_killed_program)
    with Readiness(path, environment={}) as readiness:
        assert not path.exists()
        readiness.ready()
        assert path.read_text() == f"{os.getpid()}\n"
        assert list(tmp_path.iterdir()) == [path], "nothing else is left there"
    assert not path.exists()


def test_the_file_of_a_program_that_runs_is_replaced_when_ready_and_not_before(tmp_path: Path) -> None:
    path, other = tmp_path / "run.ready", f"{os.getppid()}\n"
    path.write_text(other)
    with Readiness(path, environment={}):
        """It leaves before it is ready."""
    assert path.read_text() == other
    with Readiness(path, environment={}) as readiness:
        assert path.read_text() == other
        readiness.ready()
        assert path.read_text() == f"{os.getpid()}\n"
    assert not path.exists()


@pytest.mark.parametrize("content", ["modules: []\n", "", "12\n13\n"])
def test_another_file_is_not_touched(tmp_path: Path, content: str) -> None:
    path = tmp_path / "feedback.yaml"
    path.write_text(content)
    with pytest.raises(ConfigError, match=r"feedback\.yaml: exists, and is not"), Readiness(path):
        pytest.fail("entered")
    assert path.read_text() == content


@pytest.mark.parametrize(
    ("name", "reason"), [("no/such/folder", "No such file"), (".", "exists, and is not a ready file")]
)
def test_a_file_that_cannot_be_is_refused_at_the_start(tmp_path: Path, name: str, reason: str) -> None:
    with pytest.raises(ConfigError, match=reason), Readiness(tmp_path / name):
        pytest.fail("entered")


def test_who_waits_must_not_wait_for_ever(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    with Readiness(folder / "run.ready", environment={}) as readiness:
        folder.rmdir()
        with pytest.raises(CanfbError, match=r"run\.ready: No such file"):
            readiness.ready()


def test_systemd_gets_ready_and_stopping(tmp_path: Path, manager: socket.socket) -> None:
    with Readiness(environment={"NOTIFY_SOCKET": str(tmp_path / "notify")}) as readiness:
        with pytest.raises(BlockingIOError):
            manager.recv(100)
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


def test_an_abstract_socket_of_systemd() -> None:
    name = f"@canfb-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.bind("\0" + name[1:])
        one.settimeout(10.0)
        with Readiness(environment={"NOTIFY_SOCKET": name}) as readiness:
            readiness.ready()
            assert one.recv(100) == b"READY=1"


def test_a_service_manager_that_has_gone_is_a_line_and_no_more(tmp_path: Path) -> None:
    lines: list[str] = []
    environment = {"NOTIFY_SOCKET": str(tmp_path / "nobody")}
    with Readiness(report=lines.append, environment=environment) as readiness:
        readiness.ready()
    assert lines == [f"NOTIFY_SOCKET {tmp_path}/nobody: No such file or directory"] * 2
