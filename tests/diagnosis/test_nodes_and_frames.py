"""Frames in words, and `canfb node list`: who is there, and nothing that harms anybody."""

import contextlib
import struct
from collections import Counter

import can
import pytest
from hypothesis import given, strategies as st

from canfb import Config, Frame, eds_path, objects as od
from canfb.diagnosis.nodes_and_frames import FoundNode, FrameWords, learn_by_sdo, scan
from canfb.monitoring.layout import known_objects
from canfb.objects import LossCause
from canfb.sdo.object_description import ObjectDescriptions
from canfb.view.module_view import Read
from commands import Command
from commissioning_kit import INTERFACE_ID, MODULE_ID, Bench, EmbeddedMaster, heard
from folding import each
from node_commands import between, place_of

EDS = ObjectDescriptions(eds_path("canfb-module"), 1)


def words_of(read: Read) -> FrameWords:
    """Of the module, whose objects ``read`` gives."""
    words = FrameWords(EDS)
    words.learn(MODULE_ID, read)
    return words


WORDS = words_of(known_objects(Config(), [MODULE_ID])[MODULE_ID][0])


def test_the_position_pdo_has_its_objects_by_name_with_units() -> None:
    decoded = WORDS.decode(Frame(0x1A0, struct.pack("<IHH", 123456, 0x81, 0x1000)))
    assert decoded.text == (
        "TPDO1 of 32: position value 123456 measuring units, status word 129 (valid, table active), "
        "residual 4096 (0.0625 cycle)"
    )
    assert decoded.values == {"6004:00": 123456, "2011:01": 129, "2011:02": 4096}
    assert decoded.is_pdo
    assert decoded.line(0.25) == f"(0.250000)  1A0  [8]  40 E2 01 00 81 00 00 10  {decoded.text}"


@each(
    "can_id, data, kind, node, text",
    [
        (0x000, b"\x01\x20", "nmt", 32, "NMT start: 32"),
        (0x000, b"\x82\x00", "nmt", None, "NMT reset communication: all nodes"),
        (0x080, b"", "sync", None, "SYNC"),
        (0x080, b"\x07", "sync", None, "SYNC, counter 7"),
        (0x100, bytes(6), "time", None, "TIME"),
        (0x720, b"\x00", "heartbeat", 32, "boot-up of 32"),
        (0x710, b"\x85", "heartbeat", 16, "heartbeat of 16: OPERATIONAL"),
        (0x620, b"\x40\x11\x20\x01" + bytes(4), "sdo request", 32, "SDO request to 32, 2011:01"),
        (0x5A0, b"\x80\x11\x20\x01" + bytes(4), "sdo response", 32, "SDO response of 32, 2011:01, abort"),
        (0x620, b"\x60" + bytes(7), "sdo request", 32, "SDO request to 32"),  # segments, and those of a block
        (0x5A0, b"\x30" + bytes(7), "sdo response", 32, "SDO response of 32"),
        (0x620, b"\x81segment", "sdo request", 32, "SDO request to 32"),
        (0x5A0, b"\x70segment", "sdo response", 32, "SDO response of 32"),
        (0x7E5, bytes(8), "lss", None, "LSS, master"),
        (0x280, bytes(2), "", None, ""),
        (0x285, bytes(2), "", 5, "PDO, TPDO2 of 5 by its CAN-ID"),
        (0x1A0, bytes(3), "tpdo", 32, "TPDO1 of 32: 3 bytes, 8 are mapped"),
        (0x0A0, struct.pack("<HB5s", 0x7300, 0x21, bytes((0x44, 0, LossCause.TIME, 3, 0))), "emcy", 32,
         "EMCY of 32: 7300h sensor: position not valid, 1001h 21h; lost: the number of intervals that passed "
         "is not known"),
        (0x085, b"\0\x73\x21\0\0\3\0\0", "emcy", 5, "EMCY of 5: 7300h sensor: position not valid, 1001h 21h"),
        (0x085, b"\x10\xff\x81" + bytes(5), "emcy", 5, "EMCY of 5: FF10h device specific, 1001h 81h"),
        (0x0A0, struct.pack("<HB5s", 0x8130, 0x11, b""), "emcy", 32,
         "EMCY of 32: 8130h heartbeat or life guard error, 1001h 11h"),
    ],
)  # fmt: skip
def test_other_frames(can_id: int, data: bytes, kind: str, node: int | None, text: str) -> None:
    decoded = WORDS.decode(Frame(can_id, data))
    assert (decoded.kind, decoded.node, decoded.text) == (kind, node, text)
    assert decoded.figures(1.0)["node"] == node


@given(st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans())
def test_no_frame_raises(can_id: int, data: bytes, rtr: bool) -> None:
    decoded = WORDS.decode(Frame(can_id, data, rtr))
    assert decoded.line(0.0)
    assert decoded.figures(0.0)["data"] == data.hex()


def test_the_mapping_of_a_module_that_answers_is_read_from_it() -> None:
    bench = Bench(sync=False)
    entry = bench.module.dictionary.entry
    entry(od.TPDO_MAPPING, 3).value = od.FEEDBACK_AMPLITUDE.mapped(16)
    words = FrameWords(EDS)
    assert learn_by_sdo(words, bench.master, [MODULE_ID, INTERFACE_ID, 99]) == {MODULE_ID}
    decoded = words.decode(Frame(0x1A0, struct.pack("<IHH", 0, 0, 1400)))
    assert decoded.values["2011:05"] == 1400
    assert words.decode(Frame(0x180 + INTERFACE_ID, bytes(4))).kind == "rpdo"


def test_real_values_and_bits() -> None:
    mapped = od.FEEDBACK_VELOCITY.mapped(32)
    values = {(od.TPDO, 1): 0x1A0, (od.TPDO_MAPPING, 0): 1, (od.TPDO_MAPPING, 1): mapped}
    words = words_of(lambda place: values.get((place[0], place[1])))
    decoded = words.decode(Frame(0x1A0, struct.pack("<f", 6.5)))
    assert decoded.values["2011:07"] == pytest.approx(6.5)
    assert "velocity 6.5 rad/s" in decoded.text
    assert words.decode(Frame(0x1A0, struct.pack("<f", float("nan")))).values["2011:07"] is None


def scanned(bench: Bench, seconds: float = 0.3) -> dict[int, FoundNode]:
    return {one.node: one for one in scan(EmbeddedMaster(bench.bus), seconds)}


def test_all_nodes_with_state_and_identity_and_nothing_is_written() -> None:
    bench = Bench(sync=False)
    bench.module.receive(Frame(0x000, bytes((0x80, MODULE_ID))), 0.0)
    frames, at_once = heard(bench), Counter[float]()
    bench.bus.observers.append(lambda frame, now: at_once.update([now] * (frame.data[:4] == b"\x40\0\x10\0")))
    found = scanned(bench)
    requests = [frame for frame in frames if 0x600 <= frame.can_id < 0x680]
    assert len({frame.can_id for frame in requests}) == 127
    assert max(at_once.values()) <= 10, "the queue of SocketCAN"
    assert all(frame.data[0] in (0x40, 0x60, 0x70) for frame in requests), "uploads only"
    assert not any(frame.can_id == 0 for frame in frames)
    assert sorted(found) == [INTERFACE_ID, MODULE_ID]
    module, interface = found[MODULE_ID], found[INTERFACE_ID]
    assert (module.state, interface.state) == ("PRE-OPERATIONAL", "OPERATIONAL")
    assert module.name == "canfb drive feedback module"
    assert (module.device_type, module.product_code) == (0x00040196, 1)
    assert interface.product_code == 2
    assert module.line().startswith(
        " 32 (20h)  PRE-OPERATIONAL  canfb drive feedback module, vendor 0h product 1h"
    )


def test_a_stopped_node_is_known_by_its_heartbeat() -> None:
    bench = Bench(sync=False)
    bench.module.dictionary.entry(0x1017).download((100).to_bytes(2, "little"))
    bench.bus.send(Frame(0x000, bytes((0x02, MODULE_ID))))
    stopped = scanned(bench)[MODULE_ID]
    assert stopped == FoundNode(MODULE_ID, "STOPPED")
    assert stopped.line() == " 32 (20h)  STOPPED          answers no SDO"


def test_an_answer_that_is_lost_is_not_known() -> None:
    bench = Bench(sync=False)
    asked = Counter[bytes]()

    def losing(frame: Frame) -> list[Frame] | None:
        asked[frame.data] += 1
        is_lost = place_of(frame) == (0x1008, 0) or (place_of(frame) == (0x1000, 0) and asked[frame.data] > 1)
        return [] if is_lost else None

    between(bench, losing)
    found = scanned(bench)[MODULE_ID]
    assert (found.name, found.device_type, found.product_code) == (None, None, 1)
    assert found.line().startswith(" 32 (20h)  OPERATIONAL      device type not known, vendor 0h product 1h")


def test_a_node_that_a_master_guards_is_not_asked_for_its_state() -> None:
    bench = Bench(sync=False)
    bench.module.dictionary.entry(0x100C).value = 100
    frames = heard(bench)
    found = scanned(bench)
    assert found[MODULE_ID].state is None
    assert "state not known" in found[MODULE_ID].line()
    assert [frame.can_id for frame in frames if frame.rtr] == [0x700 + INTERFACE_ID]


def test_the_command(monkeypatch: pytest.MonkeyPatch, command: Command) -> None:
    opened = contextlib.nullcontext(EmbeddedMaster(Bench(sync=False).bus))
    monkeypatch.setattr("canfb.cli.node_command.BusMaster", lambda *_: opened)
    line = "node list -i virtual -c scan-x --seconds 0.3"
    assert [one[:9] for one in command(line).lines] == [" 16 (10h)", " 32 (20h)"]
    figures = command(f"{line} --json").json
    assert [one["node"] for one in figures] == [16, 32]
    assert figures[1]["state"] == "OPERATIONAL"


def test_an_empty_bus(command: Command) -> None:
    with can.Bus(interface="virtual", channel="scan-empty"):
        said = command("node list -i virtual -c scan-empty --seconds 0.1").out
        refused = command("node reset all -i virtual -c scan-empty", code=1).err
    assert said.startswith("no node answers")
    assert refused == f"canfb: {said}"
