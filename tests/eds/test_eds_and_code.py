"""The EDS files and the code that serves them: neither has an object that the other does not know."""

import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

from canfb import FeedbackModule, Frame, ModuleConfig, eds_path
from canfb.device.od.dictionary import Dictionary, Entry
from canfb.interface.encoder_interface import EncoderInterface
from canfb.module.parameters import SAME_UNIT
from canfb.sdo.object_description import ObjectDescriptions
from canfb.simulation.cia402.drive import ServoDrive
from canfb.simulation.cia402.plant import DriveConfig, Motor, Plant
from eds_text import DRIVE, INTERFACE, MODULE, EdsText, eds_of
from played import Still

NODE_ID = 32
SYNC, SAMPLE = Frame(0x080, b""), Frame(0x190, bytes(4))
MASTER_LSS, SLAVE_LSS = 0x7E5, 0x7E4

CONSTANTS = {
    0x1000: "device type", 0x1008: "name of the device", 0x1009: "version", 0x100A: "version",
    0x1018: "identity", 0x1022: "format of 1021h: plain text", 0x6504: "alarms that there are",
    0x6506: "warnings that there are", 0x6507: "versions",
}  # fmt: skip
"""Objects whose default in the EDS is all there is to them: no code reads or writes them."""
CONSTANT_ENTRIES = {(0x650A, 1): "offset of the manufacturer: none"}
NOT_OFFERED = {
    INTERFACE: {
        (0x1007, 0): "its PDO goes out with the SYNC: there is nothing that a window could hold back",
        **dict.fromkeys(
            ((0x1010, 3), (0x1010, 4), (0x1011, 3), (0x1011, 4)),
            "it has parameters of the communication alone",
        ),
        (0x1015, 0): "it reports errors of the communication only, which come singly",
    }
}
"""Objects that the code of device/ would serve, by device, and why its EDS does without."""
GENERIC = {("mapping.py", "resolve")}
"""Files and functions that look up whatever a master names, and so serve nothing by that."""

Device = FeedbackModule | EncoderInterface | ServoDrive


DEVICES: dict[str, Callable[[], Device]] = {
    MODULE: lambda: FeedbackModule(ModuleConfig(node_id=NODE_ID, autostart=True)),
    INTERFACE: lambda: EncoderInterface(NODE_ID, Still(), autostart=True),
    DRIVE: lambda: ServoDrive(Plant(Motor(DriveConfig(node_id=NODE_ID))), autostart=True),
}


class Spy:
    """Notes what is looked up in a dictionary."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.touched: set[tuple[int, int]] = set()
        self.missed: set[tuple[int, int]] = set()
        find, contains = Dictionary.find, Dictionary.__contains__

        def spied_find(dictionary: Dictionary, index: int, subindex: int = 0) -> Entry | None:
            found = find(dictionary, index, subindex)
            code = sys._getframe(1).f_code
            if (Path(code.co_filename).name, code.co_name) not in GENERIC:
                (self.missed if found is None else self.touched).add((index, subindex))
            return found

        def spied_entry(dictionary: Dictionary, index: int, subindex: int = 0) -> Entry:
            found = find(dictionary, index, subindex)
            assert found is not None, f"{index:04X}h:{subindex:02X} is used, but is not in the EDS"
            self.touched.add((index, subindex))
            return found

        def spied_contains(dictionary: Dictionary, key: tuple[int, int]) -> bool:
            self.touched |= {key} if contains(dictionary, key) else set()
            return contains(dictionary, key)

        monkeypatch.setattr(Dictionary, "find", spied_find)
        monkeypatch.setattr(Dictionary, "entry", spied_entry)
        monkeypatch.setattr(Dictionary, "__contains__", spied_contains)


@pytest.fixture(params=DEVICES)
def name(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def eds(name: str) -> EdsText:
    return eds_of(name, NODE_ID)


@pytest.fixture
def spy(name: str, monkeypatch: pytest.MonkeyPatch) -> Spy:
    """What a device touches from power-on to its second sample."""
    spy = Spy(monkeypatch)
    device = DEVICES[name]()
    device.start(0.0)
    for count in range(1, 3):
        for frame in (SYNC, SAMPLE):
            device.receive(frame, count * 0.001)
    device.tick(1.0)
    return spy


def test_every_entry_of_the_eds_is_served(spy: Spy, eds: EdsText) -> None:
    not_served = {
        (index, sub)
        for index, sub in eds.entries
        if (index, sub) not in spy.touched
        and not (sub == 0 and eds.subs(index))  # the number of sub-indices
        and index not in CONSTANTS
        and (index, sub) not in CONSTANT_ENTRIES
        # Mapped objects, stored errors, heartbeats: as many as the EDS has.
        and not (sub and (index in (0x1003, 0x1016) or index & 0xFE00 in (0x1600, 0x1A00)))
    }
    assert texts(not_served) == []


def texts(places: Iterable[tuple[int, int]]) -> list[str]:
    return sorted(f"{index:04X}h:{sub:02X}" for index, sub in places)


def test_every_object_that_the_code_serves_is_in_the_eds(name: str, spy: Spy) -> None:
    assert texts(spy.missed) == texts(NOT_OFFERED.get(name, {}))


def test_a_constant_is_really_one(spy: Spy, eds: EdsText) -> None:
    """The two lists above are not longer than they must be."""
    written = {place for place in spy.touched if place in CONSTANT_ENTRIES or place[0] in CONSTANTS}
    # LSS and stored parameters look at the identity, and 650Bh repeats the serial number.
    assert written <= {(0x1018, sub) for sub in (1, 2, 3, 4)}


def test_device_info_says_what_a_master_may_expect(name: str, eds: EdsText) -> None:
    device = DEVICES[name]()

    def ask(can_id: int, data: bytes) -> list[Frame]:
        return device.receive(Frame(can_id, data.ljust(8, b"\0")), 0.0)

    boots = (0x700 + NODE_ID, b"\x00") in [(frame.can_id, frame.data) for frame in device.start(0.0)]
    assert eds.number("DeviceInfo", "SimpleBootUpSlave") == boots
    device.receive(Frame(0x000, b"\x80\x00"), 0.0)
    # Multiplexed PDOs are refused.
    ask(0x600 + NODE_ID, b"\x23\x00\x18\x01" + (0x80000180 + NODE_ID).to_bytes(4, "little"))
    ask(0x600 + NODE_ID, b"\x2f\x00\x1a\x00")
    for count in (0xFE, 0xFF):
        (answer,) = ask(0x600 + NODE_ID, bytes([0x2F, 0x00, 0x1A, 0, count]))
        assert eds.number("DeviceInfo", "GroupMessaging") == (answer.data[0] == 0x60)
    ask(MASTER_LSS, b"\x04\x01")
    supported = [frame.can_id for frame in ask(MASTER_LSS, b"\x5e")] == [SLAVE_LSS]
    assert eds.number("DeviceInfo", "LSS_Supported") == supported


def test_a_time_of_the_configuration_has_its_unit_in_the_eds() -> None:
    described = ObjectDescriptions(eds_path("canfb-module"), NODE_ID)
    times = {name: described.entry(*place).unit for name, place in SAME_UNIT.items() if name.endswith("_s")}
    assert times == dict.fromkeys(("sync_jitter_s", "answer_delay_s"), "s")
