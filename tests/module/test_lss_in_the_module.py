"""Modules under an LSS master that gives node-IDs, and changes the bit rate: silent about the switch."""

import canopen
import canopen.lss
import pytest
from module_bench import Bench

from canfb import FeedbackModule, Frame, ModuleConfig, eds_path
from canfb.cia301.codes import NmtState
from canfb.demo.story import EmbeddedNetwork
from canfb.device.lss import UNCONFIGURED
from canfb.interface.encoder_interface import EncoderInterface
from canfb.simulation.embedded_bus import EmbeddedBus
from ideal_tracks import counts_at, wavy_table
from played import Still
from sdo_client import download_steps

NODE_ID, DELAY_S = 0x20, 0.05
BOOT_UP, EMCY, POSITION, SDO, HEARTBEAT = 0x720, 0xA0, 0x1A0, 0x5A0, 0x720
TABLE = wavy_table()
Timed = tuple[float, Frame]


class Line(Bench):
    """The module with a heartbeat, and everything that it sends, with its time; SYNCs of 1 ms on demand."""

    def __init__(self) -> None:
        super().__init__()
        self.timed: list[Timed] = []
        self.switched: list[tuple[int, float, float]] = []
        self.module.on_bit_rate = lambda *what: self.switched.append(what)
        self.bus.observers.append(self._keep)
        self.sdo[0x1017].raw = 25  # ms
        self.start()
        self.place = 0.0

    def _keep(self, frame: Frame, now: float) -> None:
        if frame.can_id in (BOOT_UP, EMCY, POSITION, SDO):
            self.timed.append((now, frame))

    def asked(self, request: str) -> list[str]:
        answers = self.sent(Frame(0x600 + NODE_ID, bytes.fromhex(request).ljust(8, b"\x00")))
        return [frame.data.hex().upper() for frame in answers if frame.can_id == SDO]

    def lss(self, *data: int) -> None:
        self.sent(Frame(0x7E5, bytes(data).ljust(8, b"\x00")))

    def switch(self, delay_s: float = DELAY_S, index: int | None = 2) -> None:
        """All at once: configuration state, bit timing (2: 500 kbit/s), activate."""
        self.lss(0x04, 1)
        if index is not None:
            self.lss(0x13, 0, index)
        self.lss(0x15, *round(delay_s * 1000).to_bytes(2, "little"))

    def run(self, duration_s: float, samples: bool = True) -> list[Timed]:
        """Let time pass, with SYNC and sample each millisecond; what was sent."""
        before = len(self.timed)
        for _ in range(round(duration_s * 1000)):
            if samples:
                self.place += 0.01
                self.sync()
                self.counts(*counts_at(self.place))
            else:
                self.bus.run_until(self.bus.now + 1e-3)
        return self.timed[before:]


@pytest.fixture
def line() -> Line:
    return Line()


def test_it_is_silent_for_the_delay_before_and_after_the_switch(line: Line) -> None:
    before = line.run(0.1)
    assert {frame.can_id for _, frame in before} >= {POSITION, HEARTBEAT}
    line.switch()
    began = line.bus.now
    assert line.switched == [(500, DELAY_S, began)]
    after = line.run(0.2)
    assert 2 * DELAY_S <= after[0][0] - began <= 2 * DELAY_S + 2e-3
    assert {frame.can_id for _, frame in after} >= {POSITION, HEARTBEAT}


@pytest.mark.parametrize("index", [None, 0, 3], ids=["nothing configured", "not offered", "refused"])
def test_a_refused_activation_makes_no_silence(line: Line, index: int | None) -> None:
    line.run(0.02)
    line.switch(index=index)
    assert line.switched == []
    assert line.asked("4000100000000000") == ["4300100096010400"]
    assert len([frame for _, frame in line.run(0.02) if frame.can_id == POSITION]) == 20


def test_a_table_upload_that_falls_into_it_is_given_up(line: Line) -> None:
    requests = [request.hex() for request, _ in download_steps(bytes.fromhex("202001"), TABLE.to_bytes())]
    assert all(line.asked(request) for request in requests[:10])
    line.switch()
    assert line.asked(requests[10]) == []  # the client sees no answer ...
    line.run(2 * DELAY_S + 1e-3, samples=False)
    (abort,) = line.asked(requests[10])
    assert (abort[:2], abort[8:]) == ("80", "01000405")  # ... and a late segment 05040001h
    assert line.module.dictionary.entry(0x2020, 2).value == 0
    assert all(line.asked(request) for request in requests)  # the next try works
    assert line.module.dictionary.entry(0x2020, 2).value == TABLE.crc32


def test_a_boot_up_and_an_emergency_that_fall_into_it_follow(line: Line) -> None:
    line.run(0.05)
    line.switch()
    assert line.sent(Frame(0, bytes([130, NODE_ID]))) == []
    assert line.module.state is NmtState.PRE_OPERATIONAL
    line.module.emergency(0x1000, 1, b"", line.bus.now)
    after = [frame for _, frame in line.run(0.2, samples=False)]
    assert [(frame.can_id, frame.data[:2]) for frame in after[:2]] == [
        (BOOT_UP, b"\x00"),
        (EMCY, b"\x00\x10"),
    ]
    assert len([frame for frame in after if frame.data == b"\x00"]) == 1


def test_a_second_activation_lengthens_it(line: Line) -> None:
    line.switch(0.05)
    line.run(0.04)
    line.switch(0.05)
    assert line.timed[-1][0] < 0.05
    after = line.run(0.2)
    assert after[0][0] >= 0.14


MODULE = (0, 1, 1)  # vendor-ID, product code, revision number
INTERFACE = (0, 2, 1)


def test_devices_without_a_node_id_get_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lowest identity first, until nobody answers; an answer is there at once or never."""
    monkeypatch.setattr(canopen.lss.time, "sleep", lambda seconds: None)
    bus = EmbeddedBus()
    network = EmbeddedNetwork(bus)
    lss = network.lss
    lss.RESPONSE_TIMEOUT = 0
    heard: list[int] = []
    bus.observers.append(lambda frame, now: heard.append(frame.can_id))
    for serial_number in (300, 5, 77):
        bus.attach(FeedbackModule(ModuleConfig(node_id=UNCONFIGURED, serial_number=serial_number)))
    bus.attach(EncoderInterface(UNCONFIGURED, Still(), serial_number=5))
    assert heard == []
    found = []
    for node_id in range(10, 20):
        there, identity = lss.fast_scan()
        if not there:
            break
        found.append(tuple(identity))
        lss.configure_node_id(node_id)
        lss.send_switch_state_global(lss.WAITING_STATE)
        assert heard[-1] == 0x700 + node_id
    assert found == [(*MODULE, 5), (*MODULE, 77), (*MODULE, 300), (*INTERFACE, 5)]

    def master(node_id: int, eds: str) -> canopen.RemoteNode:
        return network.add_node(canopen.RemoteNode(node_id, str(eds_path(eds))))

    assert [master(node_id, "canfb-module").sdo[0x1018][4].raw for node_id in (10, 11, 12)] == [5, 77, 300]
    assert master(13, "encoder-interface").sdo[0x1800][1].raw == 0x4000018D
    network.nmt.state = "OPERATIONAL"
    bus.run_until(1.0)
