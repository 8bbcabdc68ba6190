"""A third master: the npm package `canopen` moves data by SDO. It needs node and the package:

npm install canopen@6 (it compiles a part of itself), and CANFB_NODE_CANOPEN set to the folder that has its
node_modules. It is not part of the usual run: node and a compiler are much to install for one more client.
"""

from __future__ import annotations

import json
import os
import select
import shutil
import struct
import subprocess
import zlib
from pathlib import Path
from typing import Any

import pytest
from conformance_eds import FOLDER
from conformance_kit import Tester

NODE = shutil.which("node")
PACKAGE = os.environ.get("CANFB_NODE_CANOPEN")
NO_PACKAGE = "npm install canopen@6, and set CANFB_NODE_CANOPEN to its folder"
TABLE = b"".join(struct.pack("<f", n / 128) for n in range(128))


def serve(tester: Tester, master: subprocess.Popen[bytes]) -> dict[str, Any]:
    """Carry frames between the device and the master until it tells its result."""
    assert master.stdin is not None
    assert master.stdout is not None
    for _ in range(100_000):
        due = tester.device.deadline()
        ready, _, _ = select.select([master.stdout], [], [], 0.001 if due is not None else 20.0)
        assert ready or due is not None, "the master says nothing"
        line = master.stdout.readline().decode().strip() if ready else ""
        if line.startswith("RESULT "):
            result: dict[str, Any] = json.loads(line.removeprefix("RESULT "))
            return result
        can_id, _, data = line.partition("#")
        heard = tester.send(int(can_id, 16), data) if can_id else tester.wait(0.001)
        for frame in heard:
            master.stdin.write(f"{frame.can_id:03x}#{frame.data.replace(' ', '')}\n".encode())
        master.stdin.flush()
    raise AssertionError("no result")


@pytest.mark.skipif(NODE is None or PACKAGE is None, reason=NO_PACKAGE)
def test_npm_canopen_as_the_master(module: Tester) -> None:
    command = [NODE or "node", str(Path(__file__).with_name("node_master.js"))]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0) as master:
        try:
            result = serve(module, master)
        finally:
            master.kill()
    assert result == {
        "deviceType": 0x00040196,
        "name": module.eds[0x1008, 0].default,
        "abort": 0x06020000,
        "eds": (FOLDER / "canfb-module.eds").read_text(encoding="latin-1"),
        "segmentedCrc": zlib.crc32(TABLE),
        "blockCrc": zlib.crc32(TABLE),
    }
    assert module.read(0x1017) == 100
