"""A whole session as a candump log, decoded by Wireshark's CANopen dissector: nothing is malformed."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from conformance_kit import MODULE, Tester, filled, make_tester
from test_beyond_sdo_cases import IDENTITY

TSHARK = shutil.which("tshark")


def sdo_session(tester: Tester) -> None:
    tester.read(0x1000)
    tester.write(0x1017, 0, 1000, 2)
    tester.refuse("40 00 10 01", "06090011")
    tester.upload("08 10 00")
    assert tester.download_segmented("17 10 00", bytes.fromhex("E8 03")) == "ok"
    assert tester.block_download("20 20 01", IDENTITY) == "ok"
    tester.block_upload("08 10 00")


def process_session(tester: Tester) -> None:
    tester.write(0x1016, 1, 0x000503E8, 4)
    tester.write(0x1012, 0, 0x80000100, 4)
    tester.operational()
    for _ in range(5):
        tester.send(0x080)
        tester.cause_event()
        tester.wait(0.01)
    tester.send(0x100, "00 00 00 00 00 40")
    tester.send(0x705, "05")
    tester.wait(2.5)  # the heartbeat of node 5 stays out: EMCY
    tester.send(0x705, "05")  # it is back: EMCY without an error
    tester.operational()
    tester.send(0x190)  # an RPDO is too short
    tester.nmt("02")
    tester.wait(1.1)
    tester.nmt("80")


def guarding_session(tester: Tester) -> None:
    tester.write(0x1017, 0, 0, 2)
    tester.write(0x100C, 0, 100, 2)
    tester.write(0x100D, 0, 3, 1)
    for _ in range(3):
        tester.remote(0x700 + tester.id)
        tester.wait(0.1)
    tester.wait(1.0)
    tester.nmt("82")


def session() -> Tester:
    tester = make_tester(MODULE)
    tester.wait(0.1)
    sdo_session(tester)
    process_session(tester)
    guarding_session(tester)
    tester.nmt("02")
    for request in ("04 01", "5A", "5B", "5C", "5D", "5E", "04 00"):  # LSS: what it is, to be told
        tester.send(0x7E5, filled(request))
    tester.nmt("81")
    return tester


def decoded(log: str, folder: Path, *options: str) -> str:
    path = folder / "session.log"
    path.write_text(log)
    command = [TSHARK or "tshark", "-r", str(path), "-d", "can.subdissector,canopen", *options]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
        env={**os.environ, "HOME": str(folder), "LC_ALL": "C.UTF-8"},
    )
    return done.stdout


SUMMARY = {
    "NMT Error Control: Boot-up [0x20]": 3, "NMT Error Control: Pre-operational [0x20]": 5,
    "NMT Error Control: Operational [0x20]": 1, "NMT Error Control: Stopped [0x20]": 1,
    "NMT: Start remote node [0x20]": 2, "NMT: Stop remote node [0x20]": 2,
    "NMT: Enter pre-operational state [0x20]": 1, "NMT: Reset node [0x20]": 1,
    "NMT: Reset communication [0x20]": 1, "Default-SDO (rx): Initiate upload request": 2,
    "Default-SDO (tx): Initiate upload response": 2, "Default-SDO (rx): Upload segment request": 4,
    "Default-SDO (tx): Upload segment response": 4, "Default-SDO (rx): Initiate download request": 3,
    "Default-SDO (tx): Initiate download response": 3, "Default-SDO (rx): Download segment request": 1,
    "Default-SDO (tx): Download segment response": 1, "Default-SDO (rx): Block download": 2,
    "Default-SDO (tx): Block download": 4, "Default-SDO (rx): Block upload": 4,
    "Default-SDO (tx): Block upload": 2, "Default-SDO (tx): Abort transfer": 1, " SYNC": 5,
    " TIME STAMP": 1, " EMCY": 4, " PDO1 (tx)": 10, " PDO2 (tx)": 5,
    "LSS (Master): Switch state global protocol: Configuration state": 1,
    "LSS (Slave): Inquire identity vendor-ID protocol, Vendor-ID 0x00000000": 1,
    "LSS (Slave): Inquire identity product code protocol, Product-code 0x00000001": 1,
    "LSS (Slave): Inquire node-ID protocol, Node-ID 0x00000020": 1,
}  # fmt: skip
"""What must be among the decoded frames, and at least how often. The dissector does not follow a block
transfer: it takes the segments for what their first byte means elsewhere."""

FIELDS = (
    "OD main-index: Producer heartbeat time (0x1017)",
    "OD main-index: Device type (0x1000)",
    "OD main-index: Manufacturer device name (0x1008)",
    "Abort code: Sub-index does not exist (0x06090011)",
    "Error code: Communication - Life guard error or heartbeat error (0x8130)",
    "Error code: Protocol error - PDO not processed due to length error (0x8210)",
    "Error code: Error reset or no error (0x0000)",
    "Time stamp: Nov  9, 2028 00:00:00",
    "0x31, Generic error, Communication error (overrun, error state), Device profile specific",
    "Number of segments per block: 31",
)


def test_a_whole_session_is_decoded_without_a_malformed_frame(tmp_path: Path) -> None:
    if TSHARK is None:
        reason = "no tshark; run: apt-get install tshark"
        if os.environ.get("CANFB_REQUIRE_VCAN") == "1":
            pytest.fail(reason, pytrace=False)
        pytest.skip(reason)
    tester = session()
    log = ""
    for time, can_id, data, is_remote in tester.log:
        payload = "R" if is_remote else data.replace(" ", "")
        log += f"({1_000_000_000 + time:.6f}) vcan0 {can_id:03X}#{payload}\n"
    lines = decoded(log, tmp_path).splitlines()
    assert len(lines) == len(tester.log)
    remote = sum(frame[3] for frame in tester.log)
    assert sum("CANopen" in line for line in lines) >= len(lines) - remote
    seen = {text: sum(text in line for line in lines) for text in SUMMARY}
    assert {text: count for text, count in seen.items() if count < SUMMARY[text]} == {}
    whole = decoded(log, tmp_path, "-V")
    assert "malformed" not in whole.lower()
    assert [text for text in FIELDS if text not in whole] == []


def test_a_malformed_frame_would_be_seen(tmp_path: Path) -> None:
    if TSHARK is None:
        pytest.skip("no tshark")
    broken = "(1000000000.000000) vcan0 0A0#10\n"  # an EMCY of one byte
    assert "malformed" in decoded(broken, tmp_path, "-V").lower()
