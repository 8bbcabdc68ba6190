"""``canfb try``: what it prints, what another terminal can do with it, and that nothing of it is left."""

import contextlib
import http.client
import json
import re
import shlex
import signal
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import can
import pytest

from canfb.bus.opening import open_bus
from canfb.cia301 import cob
from canfb.cli.config_file import EXAMPLE, EXAMPLE_BUS
from commands import Command
from ideal_tracks import wavy_table
from processes import Started

PATIENCE_S = 120.0
A_START = 16  # samples: those that confirm it are counted as coasted
PAGE = (Path(__file__).parents[2] / "docs" / "first-hour.md").read_text(encoding="utf-8")


@pytest.fixture
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where a program puts its temporary files."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    return tmp_path


TRY = (sys.executable, "-m", "canfb", "try")


def samples_of(read: list[str], command: Command) -> int:
    """How many samples it has processed, read as its page has a user read the status word."""
    said = command("", *(word.replace("status word", "2011:08") for word in read[1:])).out
    (count,) = re.findall(r"2011:08 .*: ([0-9]+)", said)
    return int(count)


def test_its_bus_replaces_that_of_the_example() -> None:
    assert EXAMPLE.count(EXAMPLE_BUS) == 1


@pytest.mark.usefixtures("multicast_bus")
def test_another_terminal_reads_it_and_ctrl_c_leaves_nothing(
    started: Started, own_folder: Path, command: Command
) -> None:
    file = own_folder / "try.ready"
    process = started(*TRY, "--no-page", "--json", "--ready-file", str(file))
    ready = json.loads(process.wait_for('"event": "ready"'))
    assert ready["page"] is None
    assert (ready["node_id"], ready["encoder_interface"], ready["rate_hz"]) == (0x20, 0x10, 100.0)
    if not any('"text": "position valid"' in line for line in process.lines):
        process.wait_for('"text": "position valid"')
    assert file.exists()
    shown = re.findall(r"^  (canfb .*)$", PAGE, re.M)
    assert [re.sub(r"239\.255\.\S+", ready["channel"], line) for line in shown] == ready["commands"]
    monitor, read, calibrate = (shlex.split(line) for line in ready["commands"])
    while samples_of(read, command) < A_START:
        pass
    assert command("", *read[1:]).out == "2011:01 Feedback: Status word: 1 (valid)\n"
    assert (monitor[1], calibrate[1]) == ("monitor", "calibrate")
    bus = ["-i", ready["interface"], "-c", ready["channel"]]
    assert monitor[-4:] == calibrate[-4:] == bus
    process.send(signal.SIGINT)
    assert process.wait() == 0
    assert "missed 0, residual 0, amplitude 0, coasted 7, lost 0" in json.loads(process.lines[-1])["text"]
    assert all(json.loads(line) for line in process.lines)
    assert list(own_folder.iterdir()) == []


@pytest.mark.usefixtures("multicast_bus")
def test_its_page_is_served(started: Started, own_folder: Path) -> None:
    process = started(*TRY)
    process.wait_for(
        r"^running node 32 \(20h\), .* at 100 Hz on udp_multicast 239\.255\..*; end with Ctrl-C$"
    )
    address = process.wait_for("^open http://127.0.0.1:").split()[1]
    process.wait_for("^next, in another terminal:")
    process.wait_for("^  canfb monitor 0x20 --sdo -i udp_multicast -c 239.255")
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    with contextlib.suppress(urllib.error.HTTPError):  # it answers; whom it lets in is tested elsewhere
        opener.open(address, timeout=PATIENCE_S).close()
    process.send(signal.SIGTERM)
    assert process.wait() == 0
    assert list(own_folder.iterdir()) == []


TABLE = wavy_table(amplitude=0.002)


@pytest.fixture
def network(multicast_bus: can.BusABC, started: Started) -> Any:
    """What it says when it runs: its bus and the address of the page."""
    return json.loads(started(*TRY, "--json").wait_for('"event": "ready"'))


@contextlib.contextmanager
def page(address: str) -> Iterator[http.client.HTTPResponse]:
    where = urlsplit(address)
    connection = http.client.HTTPConnection(str(where.hostname), where.port, timeout=PATIENCE_S)
    with contextlib.closing(connection):
        connection.request("GET", f"/events?{where.fragment}", headers={"Host": where.netloc})
        yield connection.getresponse()


def deviation(stream: http.client.HTTPResponse) -> str:
    """What the page says of the table next."""
    while True:
        _, _, data = stream.readline().partition(b"data: ")
        for module in json.loads(data).get("modules", []) if data else []:
            if module["deviation"]:
                return str(module["deviation"]["text"])


def asked(network: dict[str, Any], syncs: int) -> bool:
    """Whether the module is asked by SDO within so many SYNCs."""
    with open_bus({"interface": network["interface"], "channel": network["channel"]}) as bus:
        while syncs:
            message = bus.recv(PATIENCE_S)
            assert message is not None
            syncs -= message.arbitration_id == cob.SYNC
            if message.arbitration_id == cob.SDO_REQUEST + network["node_id"]:
                return True
    return False


def test_commands_beside_an_open_page(network: dict[str, Any], tmp_path: Path, command: Command) -> None:
    file = tmp_path / "table.bin"
    file.write_bytes(TABLE.to_bytes())
    node, bus = network["node_id"], f"-i {network['interface']} -c {network['channel']} --timeout 60"
    assert not asked(network, 100), "nobody looks"
    with page(network["page"]) as stream, page(network["page"]):
        assert asked(network, 100_000)
        while not deviation(stream).startswith("no table is active"):
            pass
        for line in (
            f"sdo read {node} 2011:08",
            f"table show {node}",
            f"table write {node} {shlex.quote(str(file))} --activate",
            f"sdo read {node} 2012",
        ) * 3:
            command(f"{line} {bus}")
        while f"with the active table {TABLE.crc32:08X}h" not in deviation(stream):
            pass
        command(f"table clear {node} {bus}")
        while not deviation(stream).startswith("no table is active"):
            pass
