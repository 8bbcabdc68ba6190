"""`canfb log record`: what a bus gave stands in the log, in each format, however the recording ends."""

import errno
import signal
from pathlib import Path
from typing import Any

import can
import pytest

from canfb.errors import CanfbError, ConfigError
from canfb.hosting.readiness import Readiness
from canfb.logfile.bus_logs import BusLog
from commands import Command
from fake_bus import FakeBus, FakeClock, message
from folding import each

EPOCH_S = 1_700_000_000.0


def frames(number: int) -> list[can.Message]:
    return [
        message(0x180 + n % 3, bytes([n % 256, 7]), timestamp=EPOCH_S + n * 1e-3, channel=0)
        for n in range(number)
    ]


def recorded(path: Path, plan: list[Any], seconds: float = 1.0, **options: Any) -> BusLog:
    clock = FakeClock()
    bus = FakeBus(clock, [(0.001 * n, item) for n, item in enumerate(plan)])
    with BusLog(path, clock=clock, sleep=clock.sleep, **options) as bus_log:
        bus_log.record(bus, seconds)  # type: ignore[arg-type]
    assert clock.now - bus.start == pytest.approx(seconds, abs=0.2)
    return bus_log


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc", ".mf4", ".csv", ".log.gz", ".asc.gz"])
def test_python_can_reads_what_was_recorded(tmp_path: Path, suffix: str) -> None:
    if suffix == ".mf4":
        pytest.importorskip("asammdf")
    path, plan = tmp_path / f"bus.2026-11-29{suffix}", frames(21)
    plan[20] = message(0x720, timestamp=EPOCH_S + 0.02, is_remote_frame=True, channel=0)
    sent = plan[:20] if suffix == ".trc" else plan
    assert recorded(path, plan).frames == len(sent)
    shown = path.rename(tmp_path / f"bus{suffix}")  # python-can takes no other dot in the name of a .gz
    read = [*can.LogReader(shown)]
    assert all(one.equals(other, None, False, False) for one, other in zip(read, sent, strict=True))
    for n, one in enumerate(read):
        assert one.timestamp - read[0].timestamp == pytest.approx(n * 1e-3, abs=2e-6)


def test_a_full_file_is_renamed_and_nothing_is_lost(tmp_path: Path) -> None:
    recorded(tmp_path / "bus.log", frames(100), max_bytes=1000)
    files = sorted(tmp_path.glob("bus*.log"), key=lambda path: path.stat().st_mtime_ns)
    assert len(files) > 3
    assert all(path.stat().st_size <= 1100 for path in files)
    read = sorted(one.timestamp for path in files for one in can.LogReader(path))
    assert read == pytest.approx([EPOCH_S + n * 1e-3 for n in range(100)], abs=2e-6)


def test_a_bus_that_fails_is_tried_again(tmp_path: Path) -> None:
    plan = [*frames(3), can.CanOperationError("gone"), *frames(2)]
    assert recorded(tmp_path / "bus.log", plan).frames == 5


@pytest.mark.parametrize("of_udp", [True, False])
def test_senders_of_udp_multicast_are_one_channel(
    tmp_path: Path, of_udp: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("canfb.logfile.bus_logs.brings_own_frames_back", lambda bus: of_udp)
    plan = [message(0x180 + n, channel=f"sender{n % 3}") for n in range(6)]
    recorded(tmp_path / "bus.log", plan)
    channels = {one.channel for one in can.LogReader(tmp_path / "bus.log")}
    assert channels == ({"udp_multicast"} if of_udp else {"sender0", "sender1", "sender2"})


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(writer: object, msg: can.Message) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(can.CanutilsLogWriter, "on_message_received", full)
    with pytest.raises(CanfbError, match=r"bus\.log: cannot be written: No space left on device"):
        recorded(tmp_path / "bus.log", frames(3))


@each("name, options, words", [
    ("bus.xyz", {}, r"unknown suffix '\.xyz'; bus logs end with \.asc, \.blf, "),
    ("bus", {}, "no suffix; "),
    ("bus.db", {}, r"unknown suffix '\.db'; "),  # written in a thread that ends unheard on a full disk
    ("bus.blf.gz", {}, r"\.blf cannot be compressed with gzip"),
    ("bus.log.gz", {"max_bytes": 100}, r"divides \.asc, \.blf, \.log, not \.gz"),
    ("bus.trc", {"max_bytes": 100}, r"--max-size: python-can divides \.asc, \.blf, \.log, not \.trc"),
    ("nowhere/bus.log", {}, "there is no folder"),
    ("there.log", {}, "exists; take another name, or --force"),
])  # fmt: skip
def test_what_cannot_be_is_one_line(tmp_path: Path, name: str, options: dict[str, Any], words: str) -> None:
    (tmp_path / "there.log").write_text("mine")
    with pytest.raises(ConfigError, match=words):
        BusLog(tmp_path / name, **options)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["there.log"]
    assert (tmp_path / "there.log").read_text() == "mine"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_a_signal_ends_the_command_cleanly(
    tmp_path: Path, number: signal.Signals, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    write = BusLog.write

    def last(bus_log: BusLog, *rest: Any) -> None:
        write(bus_log, *rest)
        signal.raise_signal(number)

    monkeypatch.setattr(BusLog, "write", last)
    with can.Bus(interface="virtual", channel="recorded") as bus:
        monkeypatch.setattr(Readiness, "ready", lambda readiness: bus.send(message(0x123, b"\1")))
        path = tmp_path / "bus.log"
        assert command("log record -i virtual -c recorded", path).lines[-1] == "1 frames"
    (read,) = can.LogReader(path)
    assert (read.arbitration_id, bytes(read.data)) == (0x123, b"\1")
