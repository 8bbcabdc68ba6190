"""docs/attach.md: its claims about CAN-IDs and ages of positions are tried, its examples are run."""

import random
import re
import struct
from typing import Any

import canopen
import pytest

from canfb import FeedbackModule, Frame, ModuleConfig, StatusBit
from canfb.cia301.codes import NmtState
from canfb.demo.story import EmbeddedNetwork
from canfb.device.storage.storage import MemoryStore
from canfb.simulation.embedded_bus import EmbeddedBus
from documentation import blocks, page
from ideal_tracks import counts_at

PAGE = page("attach").partition("\n## Several")[0]
NODE, INTERFACE = 0x20, 0x10
SYNC, OFF, NO_REMOTE = Frame(0x80, b""), 1 << 31, 1 << 30
TRACKS = 0x190
UNITS_PER_CYCLE = 8192
OWN = {0x0A0, 0x1A0, 0x2A0, 0x5A0, 0x720, 0x7E4}


class Bus:
    """A module alone, frame by frame; ``sent`` is all that it has sent."""

    def __init__(self, store: MemoryStore | None = None, **config: Any) -> None:
        self.module = FeedbackModule(
            ModuleConfig(node_id=NODE, encoder_interface=INTERFACE, **config), store=store
        )
        self.now = 0.0
        self.tracks = TRACKS
        self.sent = self.module.start(0.0)

    def hear(self, *frames: Frame) -> list[Frame]:
        answers = []
        for frame in frames:
            self.now += 1e-4
            answers += self.module.receive(frame, self.now)
        self.sent += answers
        return answers

    def wait(self, seconds: float) -> list[Frame]:
        end, sent = self.now + seconds, []
        while (due := self.module.deadline()) is not None and due <= end:
            self.now = max(self.now, due)
            sent += self.module.tick(self.now)
        self.now = end
        self.sent += sent
        return sent

    def write(self, index: int, subindex: int, value: int, size: int = 4) -> None:
        request = struct.pack("<BHBI", 0x23 | (4 - size) << 2, index, subindex, value)
        (answer,) = self.hear(Frame(0x600 + NODE, request))
        assert answer.data[0] == 0x60, f"{index:04X}:{subindex:02X} {answer.data.hex()}"

    def start(self) -> None:
        self.hear(Frame(0, bytes([1, 0])))

    def sample(self, cycles: float = 0.0) -> list[Frame]:
        return self.hear(Frame(self.tracks, struct.pack("<hh", *counts_at(cycles))))


def ids(frames: list[Frame]) -> set[int]:
    return {frame.can_id for frame in frames}


def test_not_operational_it_costs_one_frame() -> None:
    bus = Bus()
    bus.hear(SYNC, Frame(TRACKS, bytes(4)), SYNC, Frame(0x100, bytes(6)), Frame(0x700, b"", True))
    bus.wait(1000.0)
    assert bus.sent == [Frame(0x720, b"\x00")]


def test_as_delivered_it_sends_on_its_own_can_ids_whatever_it_hears() -> None:
    """SYNC, NMT, SDO requests, TIME, LSS commands, heartbeats: it answers, and sends none of its own."""
    rng = random.Random(406)
    bus = Bus()
    answered = (0x000, 0x080, 0x100, TRACKS, 0x1A0, 0x600 + NODE, 0x700 + INTERFACE, 0x720, 0x7E5)
    bus.start()
    for _ in range(3000):
        can_id = rng.choice(answered) if rng.random() < 0.8 else rng.randrange(0x800)
        data = rng.randbytes(rng.randrange(9))
        if can_id == 0x600 + NODE:  # reads only: a write may change a CAN-ID
            data = bytes([0x40, *rng.randbytes(7)])
        if can_id == 0x7E5:  # a new node-ID would change them all
            data = bytes([rng.choice([0x4C, 0x5A, 0x5B, 0x5C, 0x5D, 0x5E, *range(0x46, 0x4C)]), *data[:7]])
        bus.hear(Frame(can_id, data, rng.random() < 0.05))
        bus.wait(0.001)
        bus.start()
    assert ids(bus.sent) - {0x720} <= OWN
    assert {0x0A0, 0x2A0, 0x5A0, 0x720} <= ids(bus.sent)
    assert not any(frame.rtr for frame in bus.sent)


def test_every_can_id_changed_nothing_is_sent_on_the_old_ones() -> None:
    bus = Bus()
    bus.write(0x1014, 0, OFF | 0xA0)
    bus.write(0x1014, 0, 0xC5)
    for number, can_id in enumerate((0x3C1, 0x3C2, 0x3C3, 0x3C4)):
        bus.write(0x1800 + number, 1, OFF | NO_REMOTE | can_id)
        if number > 1:
            bus.write(0x1A00 + number, 1, 0x60040020)
            bus.write(0x1A00 + number, 0, 1, 1)
        bus.write(0x1800 + number, 1, NO_REMOTE | can_id)
    bus.write(0x1400, 1, OFF | TRACKS)
    bus.write(0x1400, 1, 0x3C5)
    bus.tracks = 0x3C5
    bus.write(0x1005, 0, 0x85)
    bus.start()
    bus.sent.clear()
    for k in range(20):
        bus.hear(Frame(0x85, b""))
        bus.sample(k / 64)
    for _ in range(20):  # the encoder fails
        bus.hear(Frame(0x85, b""), Frame(0x3C5, bytes(4)), SYNC, Frame(TRACKS, bytes(4)))
    assert ids(bus.sent) == {0xC5, 0x3C1, 0x3C2, 0x3C3, 0x3C4}


def test_without_autostart_no_pdo_and_with_it_at_once() -> None:
    waiting, going = Bus(), Bus(autostart=True)
    for bus in (waiting, going):
        bus.hear(SYNC)
        bus.sample()
    assert ids(waiting.sent) == {0x720}
    assert ids(going.sent) == {0x720, 0x1A0, 0x2A0}


def ages(rpdo: int, tpdo: int) -> set[tuple[str, int]]:
    """Where the position of a sample goes out, and how many SYNCs after its own."""
    bus = Bus()
    bus.write(0x1801, 1, OFF | NO_REMOTE | 0x2A0)
    bus.write(0x1400, 2, rpdo, 1)
    bus.write(0x1800, 2, tpdo, 1)
    bus.start()
    found = set()
    for k in range(40):
        for where, frames in (("sync", bus.hear(SYNC)), ("sample", bus.sample(k / 8))):
            for frame in frames:
                position, status = struct.unpack_from("<IH", frame.data)
                if status & StatusBit.VALID:
                    found.add((where, k - round(position * 8 / UNITS_PER_CYCLE)))
    return found


@pytest.mark.parametrize("tpdo", [254, 255, 0, 1])
@pytest.mark.parametrize("rpdo", [254, 255, 0, 1, 240])
def test_the_same_cycle_by_events_or_one_sync_later(rpdo: int, tpdo: int) -> None:
    assert ages(rpdo, tpdo) == {("sample", 0) if min(rpdo, tpdo) >= 254 else ("sync", 1)}


def test_type_1_sends_always_type_0_only_news() -> None:
    for kind, frames in ((1, 5), (0, 0)):
        bus = Bus()
        bus.write(0x1800, 2, kind, 1)
        bus.start()
        assert [frame.can_id for frame in bus.hear(*[SYNC] * 5)].count(0x1A0) == frames


def test_all_frames_of_cansend_are_taken() -> None:
    bus = Bus(store=MemoryStore())
    sent = re.findall(r"cansend can0 620#(\w+)", PAGE)
    assert len(sent) == 8
    for text in sent:
        (answer,) = [f for f in bus.hear(Frame(0x620, bytes.fromhex(text))) if f.can_id == 0x5A0]
        assert answer.data[:1] == b"\x60", text
    for index, subindex, value in re.findall(r"# ([0-9A-F]{4})h:0(\d) = ([0-9A-F]{8})h", PAGE):
        line = next(line for line in PAGE.splitlines() if f"{index}h:0{subindex} = {value}h" in line)
        frame = bytes.fromhex(line.split("#")[1].strip())
        assert struct.unpack_from("<HBI", frame, 1) == (int(index, 16), int(subindex), int(value, 16))
    entry = bus.module.dictionary.entry
    assert entry(0x1800, 1).value == NO_REMOTE | 0x2B5
    assert entry(0x1801, 1).value == OFF | NO_REMOTE | 0x2A0
    assert entry(0x1400, 1).value == 0x195
    assert (entry(0x1017).value, entry(0x1016, 1).value) == (100, 0x1001F4)
    bus.wait(0.05)
    bus.hear(Frame(0, bytes.fromhex("0120")))
    assert bus.module.state is NmtState.OPERATIONAL
    bus.hear(Frame(0, bytes.fromhex("8020")))
    assert bus.module.state is NmtState.PRE_OPERATIONAL


def test_the_python_example_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    bus, words = EmbeddedBus(), dict[str, Any]()
    module = FeedbackModule(ModuleConfig(node_id=NODE, encoder_interface=INTERFACE))
    bus.attach(module)
    network = EmbeddedNetwork(bus)
    monkeypatch.setattr(network, "connect", lambda **given: words.update(given) or network)
    monkeypatch.setattr(network, "disconnect", lambda: None)
    monkeypatch.setattr(canopen, "Network", lambda: network)
    (links,) = blocks(PAGE, "python")
    exec(links, {})
    assert words == {"interface": "socketcan", "channel": "can0"}
    entry = module.dictionary.entry
    assert entry(0x1800, 1).value == NO_REMOTE | 0x2B5
    assert entry(0x1801, 1).value & OFF
    assert entry(0x1400, 1).value == 0x195
    assert [entry(0x1A00, n).value for n in range(4)] == [3, 0x60040020, 0x20110110, 0x20110210]
