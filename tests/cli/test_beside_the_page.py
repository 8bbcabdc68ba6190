"""``canfb try`` with open pages: it asks only while they are open, and no command is in its way."""

from __future__ import annotations

import contextlib
import http.client
import json
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import can
import numpy as np
import pytest

from canfb.bus.opening import open_bus
from canfb.cia301 import cob
from canfb.cli.main import main
from canfb.signal.correction import CorrectionTable
from processes import Process

PATIENCE_S = 120.0
TABLE = CorrectionTable(np.arange(64) / 64 + 0.002 * np.sin(2 * np.pi * np.arange(64) / 64))


@pytest.fixture
def network(multicast_bus: can.BusABC) -> Iterator[dict[str, Any]]:
    """What it says when it runs: its bus and the address of the page."""
    process = Process((sys.executable, "-m", "canfb", "try", "--json"), PATIENCE_S)
    yield json.loads(process.wait_for('"event": "ready"'))
    process.stop()


@contextlib.contextmanager
def page(address: str) -> Iterator[http.client.HTTPResponse]:
    """Its stream."""
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


def test_commands_beside_an_open_page(
    network: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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
            assert main([*shlex.split(line), *bus.split()]) == 0, capsys.readouterr().err
        while f"with the active table {TABLE.crc32:08X}h" not in deviation(stream):
            pass
        assert main(["table", "clear", str(node), *bus.split()]) == 0
        while not deviation(stream).startswith("no table is active"):
            pass
