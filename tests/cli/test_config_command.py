"""`canfb config`: its example, what is wrong, also for this machine; a DCF, and docs/storage.md."""

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import canopen
import pytest

import canfb
from canfb import Conditioning, FeedbackModule, Frame, ModuleConfig, StateFiles, eds_path, load_config
from canfb.bus.opening import check_words
from canfb.cli import config_file
from canfb.demo.story import EmbeddedNetwork
from canfb.device.od.dcf import decode_concise
from canfb.device.storage.storage import MemoryStore, Store
from canfb.errors import CanfbError, ConfigError
from canfb.hosting.hosting import saved_configuration
from canfb.master.access import NodeAccess
from canfb.module.device_configuration import configuration_of, read_configuration
from canfb.signal.correction import CorrectionTable
from canfb.simulation.embedded_bus import EmbeddedBus
from commands import Command, yaml_file
from commissioning_kit import TABLE
from documentation import blocks, commands, page
from folding import each
from tools.soak.embedded_master import EmbeddedMaster


class Peer(EmbeddedNetwork):
    """A module on an embedded bus, and the master of the command and of the page's examples."""

    def __init__(self, config: ModuleConfig, store: Store | None = None, dictionary: Any = None) -> None:
        bus = EmbeddedBus()
        super().__init__(bus)
        self.module = FeedbackModule(config, store)
        eds = str(eds_path("canfb-module")) if dictionary is None else dictionary
        self.remote = canopen.RemoteNode(config.node_id, eds)
        self.add_node(self.remote)
        bus.attach(self.module)
        master = EmbeddedMaster(bus, answer_s=1.0)
        self.sdo, self.wait = master.sdo, master.wait

    def connect(self, *args: Any, **words: Any) -> Any:
        assert words == {"interface": "socketcan", "channel": "can0"}
        return self

    def activate(self, table: CorrectionTable) -> None:
        self.remote.sdo.download(0x2020, 1, table.to_bytes())
        self.remote.sdo.download(0x2020, 3, table.crc32.to_bytes(4, "little"))


@pytest.fixture
def yaml(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A configuration in the current folder."""
    one = "modules: [{node_id: 0x21, cycles_per_revolution: 1024, adc_bits: 16, encoder_interface: 0x11}]\n"
    monkeypatch.chdir(tmp_path)
    return yaml_file(tmp_path, "bus: {channel: can3, bitrate: 250000}\n" + one)


def test_a_dcf_that_makes_a_module_as_delivered_the_one_of_the_configuration(
    yaml: Path, command: Command
) -> None:
    out, err = command("config dcf --concise module.bin", yaml)
    assert err == ""
    assert out.splitlines()[0].startswith("module-21h.dcf: node 33 (21h), ")
    assert "; not at factory defaults: 1400:01, 2001:01, 2001:02, 2001:03, 2001:04, 6001:00, 6002:00" in out
    dictionary = canopen.import_od("module-21h.dcf")
    assert (dictionary.node_id, dictionary.bitrate) == (0x21, 250_000)
    peer = Peer(ModuleConfig(node_id=0x21), dictionary=dictionary)
    peer.remote.load_configuration()
    wanted = saved_configuration(load_config(yaml).modules[0])
    assert configuration_of(peer.module).values() == wanted.values()
    assert decode_concise(Path("module.bin").read_bytes()) == wanted.writes()
    text = Path("module-21h.dcf").read_text()
    assert "NetworkName=can3\n" in text
    assert "FileName=module-21h.dcf\n" in text
    figures = command("config dcf --json", yaml).json
    assert figures["changed"]["2001:01"] == 1024
    wanted_too = {"dcf": "module-21h.dcf", "node_id": 0x21, "table": None, "table_crc32": "00000000"}
    assert figures == figures | wanted_too | {"refused_in_index_order": []}


@pytest.mark.parametrize("name", ["0x21", "33"])
def test_one_of_several_and_bus_options_of_the_command(name: str, yaml: Path, command: Command) -> None:
    yaml.write_text("modules: [{node_id: 0x20}, {node_id: 0x21, coast_samples: 9}]\n")
    out, _ = command("config dcf -b 500000 --out a.dcf --name left_drive", yaml, name)
    assert "node 33 (21h)" in out
    assert "2010:03" in out
    text = Path("a.dcf").read_text()
    assert "Baudrate=500\n" in text
    assert "NodeName=left_drive\n" in text


def test_table_and_parameters_that_were_saved(yaml: Path, command: Command) -> None:
    config = ModuleConfig(node_id=0x20, conditioning=Conditioning(sine_gain=1.25))
    with StateFiles("state") as store:
        peer = Peer(config, store)
        peer.remote.sdo.download(0x2010, 3, b"\x07")
        peer.activate(TABLE)
        peer.remote.sdo.download(0x1010, 1, b"save")
        yaml.write_text("modules: [{node_id: 0x20, state_dir: state, coast_samples: 5}]\n")
        out, err = command("config dcf --out m.dcf", yaml)  # while the module is running
    assert err == ""
    assert f"m.table.bin: correction table, 64 entries, {TABLE.crc32:08X}" in out
    assert Path("m.table.bin").read_bytes() == TABLE.to_bytes()
    fresh = Peer(ModuleConfig(node_id=0x20), dictionary=canopen.import_od("m.dcf"))
    fresh.remote.load_configuration()
    assert fresh.module.chain.correction.table == TABLE
    assert fresh.module.chain.correction.conditioning == Conditioning(sine_gain=1.25)
    assert fresh.module.dictionary.entry(0x2010, 3).value == 7
    # The table in a file alone: lines within the 255 characters of CiA 306; the master must know the file.
    command("config dcf --out m.dcf --table file", yaml)
    text = Path("m.dcf").read_text()
    assert max(len(line) for line in text.splitlines()) <= 255
    assert "DownloadFile=m.table.bin\n" in text
    fresh = Peer(ModuleConfig(node_id=0x20), dictionary=canopen.import_od("m.dcf"))
    with pytest.raises(canopen.SdoAbortedError):
        fresh.remote.load_configuration()


def test_what_is_saved_and_damaged_makes_no_dcf(yaml: Path, command: Command) -> None:
    Path("state").mkdir()
    Path("state/manufacturer.bin").write_bytes(b"nonsense")
    yaml.write_text("modules: [{node_id: 0x20, state_dir: state}]\n")
    refused = "canfb: stored manufacturer parameters in state refused: no stored parameters, or truncated\n"
    assert command("config dcf", yaml, code=1) == ("", refused)
    assert list(Path().glob("*.dcf")) == []


def test_a_module_that_samples_itself(yaml: Path, command: Command) -> None:
    """Its source is not opened, and its RPDO1 is off."""
    yaml.write_text("modules: [{node_id: 0x20, source: {kind: recording, file: not-there.csv}}]\n")
    command("config dcf", yaml)
    assert canopen.import_od("module-20h.dcf")[0x1400][1].value == 0x80000190  # type: ignore[index]


def test_what_a_master_in_the_order_of_the_indices_cannot_write_is_told(yaml: Path, command: Command) -> None:
    with StateFiles("state") as store:
        peer = Peer(ModuleConfig(node_id=0x20), store)
        for value in (1 << 31, 0x90):
            peer.remote.sdo.download(0x1014, 0, value.to_bytes(4, "little"))
        peer.remote.sdo.download(0x1010, 1, b"save")
    yaml.write_text("modules: [{node_id: 0x20, state_dir: state}]\n")
    _, err = command("config dcf", yaml)
    assert "in the order of the indices, is refused at 1014:00; give it the concise form" in err


def test_a_live_module_is_read_by_sdo() -> None:
    peer = Peer(ModuleConfig(node_id=5, adc_bits=14, serial_number=4711, conditioning=Conditioning(1.5)))
    peer.activate(TABLE)
    read = read_configuration(NodeAccess(peer, 5, "node"))  # type: ignore[arg-type]
    assert read.values() == configuration_of(peer.module).values()
    assert read.writes() == configuration_of(peer.module).writes()
    assert (read.node_id, read.serial_number, read.table) == (5, 4711, TABLE.to_bytes())


def test_another_node_and_another_version_are_refused() -> None:
    peer = Peer(ModuleConfig(node_id=5))
    access: Any = NodeAccess(peer, 5, "node")  # type: ignore[arg-type]
    del peer.module.dictionary._entries[0x2010, 4]
    with pytest.raises(CanfbError, match=r"2010:04 is refused: .*does not exist"):
        read_configuration(access)
    peer.module.dictionary.entry(0x1000).value = 0x00040191
    want = r"node 5 \(05h\) is not a feedback module of canfb: 1000:00 is 40191h"
    with pytest.raises(CanfbError, match=want):
        read_configuration(access)


PAGE = page("storage").partition("\n## A file for the PLC")[2]
COMMANDS = commands(PAGE)
EXAMPLES = blocks(PAGE, "python")
YAML = "bus: {bitrate: 500000}\nmodules: [{node_id: 0x20, adc_bits: 16, conditioning: {sine_gain: 1.07}}]\n"


def test_commands_and_examples_make_the_module_of_the_configuration(
    yaml: Path, monkeypatch: pytest.MonkeyPatch, command: Command
) -> None:
    yaml.write_text(YAML)
    assert [words[:2] for words in COMMANDS] == [["config", "dcf"]] * 3
    for words in COMMANDS[:2]:
        command("", *words)
    network = Peer(ModuleConfig(node_id=0x20), MemoryStore())
    monkeypatch.setattr(canopen, "Network", lambda: network)
    names: dict[str, Any] = {}
    exec(compile(EXAMPLES[0], "docs/storage.md", "exec"), names)
    wanted = saved_configuration(load_config("feedback.yaml").modules[0])
    assert configuration_of(network.module).values() == wanted.values()

    # The third command reads the module; the second example writes what it has read.
    monkeypatch.setattr(config_file, "master_of", lambda options: network)
    command("", *COMMANDS[2])
    fresh = Peer(ModuleConfig(node_id=0x20), MemoryStore())
    names["node"] = fresh.add_node(0x20, canopen.import_od("module-20h.dcf"))
    exec(compile(EXAMPLES[1], "docs/storage.md", "exec"), names)
    assert configuration_of(fresh.module).values() == wanted.values()


def test_the_heartbeat_of_the_page_is_in_the_concise_form() -> None:
    def heartbeats(module: FeedbackModule) -> list[int]:
        return [
            int.from_bytes(one.data, "little")
            for one in configuration_of(module).writes()
            if (one.index, one.subindex) == (0x1017, 0)
        ]

    module = Peer(ModuleConfig(node_id=0x20)).module
    assert heartbeats(module) == [0]
    (request,) = re.findall(r"`cansend can0 620#(\w+)`", PAGE)
    module.receive(Frame(0x620, bytes.fromhex(request)), 0.0)
    assert heartbeats(module) == [500]


@pytest.fixture
def example(command: Command) -> str:
    out, err = command("config example")
    assert err == ""
    return out


def test_the_example_is_itself_valid(example: str, tmp_path: Path, command: Command) -> None:
    path = yaml_file(tmp_path, example)
    assert command("config check", path) == (f"{path}: valid; modules: 20h\n", "")
    config = canfb.load_config(path)
    assert config.bus["interface"] == "socketcan"
    assert config.modules == [
        canfb.ModuleConfig(
            node_id=0x20,
            times=True,
            residual_limit=0.3333,
            max_acceleration_rad_s2=0.25,
            coast_samples=30,
            sync_timeout_periods=20,
        )
    ]
    assert config.simulation.motion.rpm == 61


def test_what_the_example_has_in_comments_is_valid_too(example: str, tmp_path: Path) -> None:
    """The keys that are shown but left out: without their marks they must load."""
    lines = []
    for line in example.splitlines():
        stripped = line.lstrip()
        shown = stripped.startswith(
            ("# conditioning:", "#   {", "# realtime:", "# predict:", "# state_dir:", "# source:", "# drive:")
        )
        words = stripped.removeprefix("# ").partition(" # ")[0].partition("   # offset")[0]
        indent = " " * (len(line) - len(stripped))
        lines.append(f"{indent}{words}" if shown else line)
    config = canfb.load_config(yaml_file(tmp_path, "\n".join(lines)))
    assert config.realtime.priority == 80
    module = config.modules[0]
    assert module.conditioning == canfb.Conditioning()
    assert (module.predict, module.state_dir) == (True, "/var/lib/canfb/x")
    assert module.source is not None
    assert module.source.kind == "iio"
    assert config.simulation.drive is not None


MODULES = "modules:\n  - node_id: 32\n"


@pytest.fixture
def checked(tmp_path: Path, command: Command) -> Callable[..., str]:
    """What is said of a configuration, behind the name of its file."""

    def check(text: str, code: int = 2) -> str:
        path = yaml_file(tmp_path, text)
        (line,) = "".join(command("config check", path, code=code)).splitlines()
        return line.removeprefix("canfb: ").removeprefix(str(path))

    return check


WRONG = {
    f"bus: {{interface: socketcann}}\n{MODULES}":
        ":1: unknown interface 'socketcann' in bus; did you mean 'socketcan'?",
    f"bus:\n  interface: socketcan\n  chanel: can0\n{MODULES}":
        ":3: unknown key 'chanel' in bus for socketcan; did you mean 'channel'?",
    f"bus:\n  interface: socketcan\n  bitrate: 1M\n{MODULES}":
        ":3: bitrate in bus must be bits per second, such as 1000000, not '1M'",
    f"bus:\n  interface: virtual\n  receive_own_messages: true\n{MODULES}":
        ":3: receive_own_messages: omit it; a device must not receive its own frames",
    f"{MODULES}    source:\n      kind: recording\n      file: /nowhere/tracks.csv\n":
        ":5: file /nowhere/tracks.csv of source cannot be read: No such file or directory",
    f"{MODULES}    state_dir: /dev/null/x\n":
        ":3: state_dir /dev/null/x cannot be used: /dev/null is not a folder",
    f"{MODULES}    state_dir: {256 * 'x'}\n": f":3: state_dir {256 * 'x'} cannot be used: File name too long",
    f"{MODULES}realtime:\n  cpu: 65535\n": ":4: cpu 65535 in realtime: this machine has 1, 0 to 0",
    f"{MODULES}realtime: {{cpu: 0, busy_poll: true}}\n":
        ":3: busy_poll in realtime: this machine has one processor, which all programs share",
}  # fmt: skip


@pytest.mark.parametrize("text", WRONG)
def test_what_cannot_be_on_this_machine(
    text: str, checked: Callable[..., str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    assert checked(text) == WRONG[text]


@each("bus", [
    "{}",
    "{channel: can0, bitrate: 500000}",
    "{interface: socketcan, channel: can0, local_loopback: false}",
    "{interface: kvaser, channel: 0, bitrate: 500000, accept_virtual: true}",
    "{interface: pcan, channel: PCAN_USBBUS1, fd: true, f_clock_mhz: 80, nom_brp: 1, auto_reset: true}",
    "{interface: slcan, channel: /dev/ttyUSB0, bitrate: 1000000, tty_baudrate: 115200}",
    "{interface: ixxat, channel: 0, bitrate: 1000000, unique_hardware_id: HW1}",
    "{interface: gs_usb, channel: 0, bus: 1, address: 2, bitrate: 1000000}",
    "{interface: vector, channel: 0, app_name: CANalyzer, bitrate: 1000000}",
    "{interface: socketcand, channel: can0, host: localhost, port: 29536}",
    "{interface: udp_multicast, channel: 239.74.163.2, hop_limit: 1}",
])  # fmt: skip
def test_what_may_be(bus: str, tmp_path: Path, checked: Callable[..., str]) -> None:
    folder = tmp_path / "new" / "state"
    text = f"bus: {bus}\n{MODULES}    state_dir: {folder}\n  - node_id: 127\nrealtime: {{cpu: 0}}\n"
    assert checked(text, 0) == ": valid; modules: 20h, 7Fh"
    assert not folder.exists()


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_that_may_not_be_written_to(tmp_path: Path, checked: Callable[..., str]) -> None:
    tmp_path.joinpath("closed").mkdir(mode=0o500)
    assert checked(f"{MODULES}    state_dir: {tmp_path}/closed/x\n").endswith("closed is not writable")


@pytest.mark.parametrize("interface", sorted(can.VALID_INTERFACES))
def test_every_interface_knows_its_keys_without_its_driver(interface: str) -> None:
    check_words({"interface": interface, "channel": "x", "bitrate": 1000000})
    with pytest.raises(ConfigError, match="unknown key 'no_such_key' in bus"):
        check_words({"interface": interface, "no_such_key": 1})
