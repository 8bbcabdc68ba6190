"""`canfb run` with eight modules in one process, in a time that is not there; docs/attach.md has some too."""

import math
import re
import signal
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import can
import pytest

from canfb import ConfigError, FeedbackModule, Frame, ModuleConfig, StatusBit
from canfb.bus.runner import Runner
from canfb.cli.main import main
from canfb.configuration import parse_config
from canfb.hosting import serving
from documentation import blocks, page
from fake_bus import FakeBus, FakeClock, each_kind_of_bus, frame_bus, message  # noqa: F401
from folding import each

NODES = (33, 34, 35, 36, 37, 38, 39)
NEWCOMER, SERIAL = 40, 7  # waits for LSS
INTERFACES = {node: node + 40 for node in (*NODES, NEWCOMER)}
BAD_TABLE, BAD_ENCODER = 35, 36
PERIOD_S = 0.01
CYCLES = 40
SYNC = message(0x080)


def adc(node: int, cycle: int) -> bytes:
    """Each machine turns at a speed of its own; one encoder loses its signal for some samples."""
    angle = 0.02 * (node - 30) * cycle
    amplitude = 40 if node == BAD_ENCODER and 20 <= cycle < 25 else 1500
    return struct.pack("<hh", round(amplitude * math.sin(angle)), round(amplitude * math.cos(angle)))


def cycles(first_s: float) -> list[tuple[float, can.Message]]:
    plan = []
    for cycle in range(CYCLES):
        at = round(first_s + cycle * PERIOD_S, 6)
        plan.append((at, SYNC))
        plan += [(at, message(0x180 + INTERFACES[node], adc(node, cycle))) for node in INTERFACES]
    return plan


class EndingBus(FakeBus):
    """Ends the program when all has been played, before a module misses the next SYNC."""

    def recv(self, timeout: float | None = None) -> can.Message | None:
        if self.plan:
            return super().recv(timeout)
        signal.raise_signal(signal.SIGTERM)
        return None


@dataclass
class Story:
    """What became of one run."""

    status: int
    sent: dict[int, list[bytes]] = field(default_factory=dict)

    def positions(self, node: int) -> list[tuple[int, int]]:
        """6004h and status word of each position PDO."""
        return [struct.unpack("<IH", data[:6]) for data in self.sent.get(0x180 + node, [])]

    def emergencies(self, node: int) -> list[str]:
        return [data.hex() for data in self.sent.get(0x080 + node, [])]


Play = Callable[[list[tuple[float, can.Message]]], Story]


@pytest.fixture
def play(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Play:
    lines = [
        f"- {{node_id: {node}, encoder_interface: {INTERFACES[node]}, autostart: true, "
        f"state_dir: {tmp_path}/{node}}}"
        for node in NODES
    ]
    lines.append(
        f"- {{node_id: 255, serial_number: {SERIAL}, encoder_interface: {INTERFACES[NEWCOMER]}, "
        f"autostart: true, state_dir: {tmp_path}/new}}"
    )
    config = tmp_path / "eight.yaml"
    config.write_text("modules:\n" + "\n".join(lines) + "\n")

    def play(plan: list[tuple[float, can.Message]]) -> Story:
        clock = FakeClock()
        bus = EndingBus(clock, plan)

        monkeypatch.setattr(serving, "open_device_bus", lambda words: frame_bus(bus))
        monkeypatch.setattr(serving, "Runner", partial(Runner, clock=clock, sleep=clock.sleep))
        story = Story(main(["run", str(config), "-i", "socketcan", "-c", "can7"]))
        for _, sent in bus.sent:
            story.sent.setdefault(sent.arbitration_id, []).append(bytes(sent.data))
        return story

    return play


def alone(node: int) -> list[tuple[int, int]]:
    """What the module says when it has the bus for itself."""
    module = FeedbackModule(ModuleConfig(node_id=node, encoder_interface=INTERFACES[node], autostart=True))
    module.start(0.0)
    said = []
    for cycle in range(CYCLES):
        now = 1.0 + cycle * PERIOD_S
        said += module.receive(Frame(0x080, b""), now)
        said += module.receive(Frame(0x180 + INTERFACES[node], adc(node, cycle)), now)
    return [struct.unpack("<IH", frame.data[:6]) for frame in said if frame.can_id == 0x180 + node]


def test_each_has_its_own_positions_and_its_own_faults(
    play: Play, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / str(BAD_TABLE)
    bad.mkdir()
    (bad / "manufacturer.bin").write_bytes(b"no table at all")
    story = play(cycles(1.0))
    out, err = capsys.readouterr()
    assert story.status == 0
    assert set(story.sent) >= {0x700 + node for node in NODES}
    for node in NODES:
        assert story.positions(node) == alone(node), node
        assert len(story.positions(node)) == CYCLES
        valid = [bool(status & StatusBit.VALID) for _, status in story.positions(node)]
        assert all(valid) is (node != BAD_ENCODER)
        codes = [text[:4] for text in story.emergencies(node)]
        expected = {BAD_TABLE: ["1063"], BAD_ENCODER: ["0073", "0073"]}
        assert codes == expected.get(node, [])
    assert len({tuple(story.positions(node)) for node in NODES}) == len(NODES)
    assert 0x180 + NEWCOMER not in story.sent, "it waits for LSS"
    names = ", ".join(f"{node} ({node:02X}h)" for node in NODES)
    first, speed, *rest = out.splitlines()
    summaries = [line for line in rest if line.startswith("node ")]
    events = rest[: len(rest) - len(summaries)]
    assert rest == events + summaries
    for node in NODES:
        told = [line.partition("): ")[2] for line in events if f" node {node} (" in line]
        assert told[:2] == ["boot-up, PRE-OPERATIONAL", "OPERATIONAL"]
    names += f", without a node-ID yet (LSS, serial number {SERIAL})"
    assert first == f"running node {names} on socketcan can7; end with Ctrl-C"
    assert speed.startswith(f"node {names}: without sample times the jitter of SYNC limits the speed: ")
    assert [line.partition(";")[0] for line in summaries] == [
        *(f"node {node}: {CYCLES} samples" for node in NODES),
        f"node without a node-ID (serial number {SERIAL}): 0 samples",
    ]
    amplitude = {line.partition(":")[0]: line.split("amplitude ")[1].partition(",")[0] for line in summaries}
    assert {name for name, count in amplitude.items() if count != "0"} == {f"node {BAD_ENCODER}"}
    (line,) = err.splitlines()
    assert line.startswith(f"canfb: node {BAD_TABLE}: stored manufacturer parameters in {bad} refused: ")


def test_two_with_the_same_node_id_are_noticed_and_both_go_on(
    play: Play, capsys: pytest.CaptureFixture[str]
) -> None:
    twin = NODES[1]
    by_serial_number = ("4000000000", "4101000000", "4201000000", f"43{SERIAL:02X}000000")
    requests = [  # the newcomer is found, and gets a node-ID
        (0.5, message(0x7E5, bytes.fromhex(request).ljust(8, b"\0")))
        for request in (*by_serial_number, f"11{twin:02X}", "0400")
    ]
    story = play([*requests, *cycles(1.0)])
    out, err = capsys.readouterr()
    assert story.status == 0
    assert story.sent[0x700 + twin] == [b"\0", b"\0"]
    told = story.emergencies(twin)
    assert told[0] == f"508111{twin:02x}07000000", "by its boot-up"
    assert [text[:6] for text in told] == ["508111"] * 2, "each of the two, once"
    assert len(story.positions(twin)) == 2 * CYCLES
    for node in set(NODES) - {twin}:
        assert story.positions(node) == alone(node)
        assert node == BAD_ENCODER or story.emergencies(node) == []
    assert err.splitlines() == [
        f"canfb: node {twin} (22h): another node on the bus uses this node-ID (722h)",
        f"canfb: node {twin} (22h): another node on the bus uses this node-ID (0A2h)",
    ]
    summaries = [line for line in out.splitlines() if line.startswith(f"node {twin}: ")]
    assert len(summaries) == 2
    assert all(line.endswith(" frames of another node with this node-ID") for line in summaries)
    assert sum("another node" in line for line in out.splitlines()) == 2


def test_a_program_error_in_one_ends_all_and_says_which(
    play: Play, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    receive = FeedbackModule.receive

    def broken(module: FeedbackModule, frame: Frame, now: float) -> list[Frame]:
        if module.config.node_id == 38 and module.feedback is not None:
            raise ZeroDivisionError("division by zero")
        return receive(module, frame, now)

    monkeypatch.setattr(FeedbackModule, "receive", broken)
    story = play(cycles(1.0))
    out, err = capsys.readouterr()
    assert story.status == 1
    (line,) = err.splitlines()
    assert line.startswith("canfb: node 38 (26h): program error: ZeroDivisionError: division by zero (")
    assert line.endswith("; all nodes of the process end")
    assert len(story.positions(38)) == 1
    assert len([text for text in out.splitlines() if " samples; missed " in text]) == len(NODES) + 1


PAGE = page("attach").partition("\n## Several")[2]
(CONFIG,) = blocks(PAGE, "yaml")


@each("old, new", [("axis-y", "axis-x"), ("node_id: 0x21", "node_id: 255\n    serial_number: 4711")])
def test_what_must_differ(old: str, new: str) -> None:
    assert old in CONFIG
    with pytest.raises(ConfigError, match=r"modules\[[12]\]"):
        parse_config(CONFIG.replace(old, new))


def test_what_may_be_the_same() -> None:
    assert parse_config(CONFIG.replace("encoder_interface: 0x11", "encoder_interface: 0x10"))


def test_bus_off_with_and_without_the_setting() -> None:
    module = FeedbackModule(ModuleConfig(node_id=32, autostart=True))
    module.start(0.0)
    (request,) = re.findall(r"cansend can0 620#(2F29\w+)", PAGE)
    assert module.receive(Frame(0x620, bytes.fromhex(request)), 0.0)[0].data[0] == 0x60
    module.bus_off(1.0)
    assert module.state == 5
    (save,) = re.findall(r"cansend can0 620#(2310\w+)", PAGE)
    assert bytes.fromhex(save)[4:] == b"save"
