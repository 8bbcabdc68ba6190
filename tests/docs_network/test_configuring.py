"""docs/drive-network: what network_file.py reads and refuses, and configuring.py against our devices."""

from pathlib import Path

import configuring
import network_file
import pytest
from network_bench import MODULE_ID, TEXT, Network, write

from canfb.cia301.codes import NmtState
from canfb.device.storage.storage import MemoryStore
from folding import each


def test_a_whole_file(tmp_path: Path) -> None:
    file = network_file.load(write(tmp_path))
    assert list(file.nodes) == ["interface", "module"]
    assert (file.sync_period_us, file.master_id, file.master_heartbeat_ms) == (10_000, 1, 200)
    module = file.nodes["module"]
    assert module.expect == {(0x1000, 0): 0x40196, (0x1018, 1): 0, (0x1018, 2): 1, (0x1018, 3): 1}
    assert module.watches == {0x11: 300, 1: 1000}
    assert module.parameters[0x2001, 1] == (1024).to_bytes(4, "little")
    assert module.parameters[0x2010, 2] == bytes.fromhex("00004841")
    assert module.parameters[0x6002, 0] == bytes.fromhex("00000040")
    rpdo, tpdo = module.pdos[0x1400], module.pdos[0x1800]
    assert (rpdo.cob_id_value, rpdo.kind, rpdo.mapping) == (0x191, 255, (0x20000110, 0x20000210))
    assert (tpdo.cob_id_value, tpdo.kind, tpdo.mapping) == (0x400001A1, 254, (0x60040020, 0x20110110))
    assert tpdo.times == {3: 5}
    off = [index for index, pdo in module.pdos.items() if pdo.cob_id is None]
    assert off == [0x1401, 0x1402, 0x1403, 0x1801, 0x1802, 0x1803], "without a link"


@each("old, new, message", [
    ("node_id: 0x21", "node-id: 0x21", "nodes[1]: unknown key 'node-id'; known: eds, expect"),
    ("    node_id: 0x21\n", "", "nodes[1]: 'node_id' is missing"),
    ("node_id: 0x21", "node_id: 128", "nodes[1].node_id: a whole number 1 to 127 is required, not 128"),
    ("node_id: 0x21", "node_id: 0x11", "nodes[1].node_id: node-ID 17 is also that of interface"),
    ("node_id: 0x21", "node_id: 1", "nodes[1].node_id: node-ID 1 is also that of master"),
    ("name: module", "name: interface", "nodes[1].name: the name 'interface' is taken"),
    ("name: module", "name: master", "nodes[1].name: the name 'master' is taken"),
    ("canfb-module.eds", "other.eds", "No such file or directory"),
    ("canfb-module.eds", "..", "is not an EDS file"),
    ("2001:01: 1024", "2001:01: 1024.5", "2001:01: 1024.5 does not fit the data type 0007h"),
    ("2001:01: 1024", "2001:01: -1", "Cycles per revolution"),
    ("2001:01: 1024", "2001:99: 1024", "nodes[1].parameters.2001:99: the EDS of module has no such object"),
    ("2001:01: 1024", "2011:01: 1", "2011h is read only (ro)"),
    ("6002: 0x40000000", "6000: 4", "this key appears twice"),
    ("6002: 0x40000000", "6000:00: 4", "6000:00 is set twice"),
    ("2001:01: 1024", "1017: 100", "1017h is set by the key 'heartbeat_ms'"),
    ("2001:01: 1024", "1800:02: 1", "1800h is set by the key 'links'"),
    ("2001:01: 1024", "2020:01: 1", "1 does not fit the data type 000Fh"),
    ("interface: 300", "drive: 300", "nodes[1].watches.drive: there is no node 'drive'"),
    ("interface: 300", "interface: 0", "a whole number 1 to 65535 is required, not 0"),
    ("cob_id: 0x1A1", "cob_id: 0x191", "links[1].cob_id: 191h is also that of 'ADC counts'"),
    ("cob_id: 0x1A1", "cob_id: 0x1A100", "a whole number 385 to 1407 is required"),
    ("cob_id: 0x1A1", "cob_id: 1A1h", "a whole number 385 to 1407 is required, not '1A1h'"),
    ("node: module, tpdo: 1", "node: drive, tpdo: 1", "links[1].from.node: there is no node 'drive'"),
    ("node: module, tpdo: 1", "node: module, tpdo: 9", "module has none in its EDS: 1808h"),
    ("node: module, tpdo: 1", "node: interface, tpdo: 1", "interface has it in another link: 1800h"),
    ("type: 254", "type: 250", "250 is not a transmission type of a TPDO"),
    ("type: 255", "type: 252", "252 is not a transmission type of a RPDO"),
    ("[6004, 2011:01]", "[60E4, 2011:01]", "links[1].from.map[0]: the EDS of module has no 60E4"),
    ("[6004, 2011:01]", "[6001, 2011:01]", "6001 of module cannot be mapped"),
    ("[6004, 2011:01]", "[6008, 2011:01]", "80 bits are mapped; must be 1 to 64"),
    ("[6004, 2011:01]", "[]", "0 bits are mapped"),
    ("[6004, 2011:01]", "[0006]", "0006 of module cannot be mapped in this direction"),
    ("[2000:01, 2000:02]", "[2000:01]", "links[0].to[0]: takes 16 bits, 32 are sent"),
    ("[2000:01, 2000:02]", "[2011:01, 0006]", "2011:01 of module cannot be mapped in this direction"),
    ("inhibit_100us: 5", "timeout_ms: 5", "unknown key 'timeout_ms'"),
    ("[interface, module]", "[module]", "start: must list each node once: interface, module"),
    ("sync_period_us: 10000", "sync_period_us: 10", "a whole number 100 to 10000000 is required"),
    ("sync_period_us: 10000\n", "", "'sync_period_us' is missing"),
    ("start: [interface, module]", "start: [interface", "no YAML"),
    ("bus: {interface: socketcan, channel: vcan0}", "bus: can0", "a mapping, key: value, is required"),
])  # fmt: skip
def test_each_error_is_one_line_with_file_line_and_key(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    assert old in TEXT
    text = TEXT.replace(old, new, 1)
    with pytest.raises(network_file.NetworkFileError) as error:
        network_file.load(write(tmp_path, text))
    said = str(error.value)
    assert message in said
    assert "\n" not in said
    line = int(said.removeprefix(f"{tmp_path}/network.yaml:").partition(":")[0])
    assert 1 <= line <= text.count("\n") + 1
    if "is missing" not in message and "no YAML" not in message:
        assert line == TEXT[: TEXT.index(old)].count("\n") + 1


def test_dummies_fill_an_rpdo(tmp_path: Path) -> None:
    text = TEXT.replace("[2000:01, 2000:02]", "[2000:01, 0006]")
    module = network_file.load(write(tmp_path, text)).nodes["module"]
    assert module.pdos[0x1400].mapping == (0x20000110, 0x00060010)


@each("text", [
    *("", "3", "[]", "a: *b", "a: &b [*b]", "nodes: {", "\t", "bus: {interface: x}", "? [a]\n: 3"),
    *("a: !!int x", "[" * 3000, "\x07", "!!python/object:os.system x", "a: 1\na: 2"),
])  # fmt: skip
def test_no_network_at_all(tmp_path: Path, text: str) -> None:
    with pytest.raises(network_file.NetworkFileError, match=r"network\.yaml:1:|network\.yaml:2:"):
        network_file.load(write(tmp_path, text))


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(network_file.NetworkFileError, match=r"nowhere\.yaml: cannot be read"):
        network_file.load(tmp_path / "nowhere.yaml")


def configuration(network: Network, folder: Path, text: str = TEXT) -> configuring.Configuration:
    return configuring.Configuration(network.network, network_file.load(write(folder, text)))


def test_everything_is_as_the_file_says(tmp_path: Path) -> None:
    network = Network()
    made = configuration(network, tmp_path)
    made.check_identity()
    assert made.apply() == 14
    assert network.value(0x2001, 1) == 1024
    assert network.value(0x2010, 2) == 12.5
    assert network.value(0x6002) == 0x40000000
    assert network.value(0x1006) == 10_000
    assert network.value(0x1017) == 100
    assert [network.value(0x1016, n) for n in range(1, 5)] == [0x11 << 16 | 300, 1 << 16 | 1000, 0, 0]
    assert network.value(0x1400, 1) == 0x191
    assert (network.value(0x1800, 1), network.value(0x1800, 3)) == (0x400001A1, 5)
    assert network.value(0x1A00, 0) == 2
    assert network.value(0x1801, 1) & configuring.OFF
    assert made.compare() == []


def uploads_only(network: Network) -> bool:
    return {frame.data[0] >> 5 for frame in network.sent if 0x600 < frame.can_id < 0x680} <= {2, 3}


def test_another_mapping_type_and_cob_id_are_written_once(tmp_path: Path) -> None:
    """The PDO is off meanwhile, or the module would refuse it."""
    network = Network()
    text = TEXT.replace("[6004, 2011:01]", "[2011:02, 6004]").replace("0x1A1", "0x2B5")
    text = text.replace("type: 254", "type: 3")
    assert configuration(network, tmp_path, text).apply() > 0
    assert [network.value(0x1A00, n) for n in range(3)] == [2, 0x20110210, 0x60040020]
    assert [network.value(0x1800, n) for n in (1, 2, 3)] == [0x400002B5, 3, 5]
    network.sent.clear()
    assert configuration(network, tmp_path, text).apply() == 0
    assert uploads_only(network)


def test_identity_and_compare_write_nothing(tmp_path: Path) -> None:
    network = Network()
    before = network.values()
    made = configuration(network, tmp_path)
    made.check_identity()
    lines = made.compare()
    assert "module (21h) 2001:01 is 000009C4h, not 00000400h" in lines
    assert not any("1801:01 is 800" in line for line in lines)
    assert network.values() == before
    assert uploads_only(network)
    assert not [frame for frame in network.sent if frame.can_id == 0]


SAVED = "    eds: canfb-module.eds\n    save: true\n"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("node_id: 0x21", "node_id: 0x22", "module (22h) 1000:00: no answer"),
        (
            "product_code: 1,",
            "product_code: 7,",
            "module (21h) 1018:02: another device, 00000001h where 00000007h",
        ),
        ("6000: 4", "6000: 8", "module (21h) 6000:00: abort 06090030h, Value range of parameter exceeded"),
        ("    eds: canfb-module.eds\n", SAVED, "module (21h) 1010:01: abort 08000020h"),
    ],
)
def test_a_failure_names_node_and_object_and_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, said: str
) -> None:
    network = Network()
    before = network.values()
    made = configuration(network, tmp_path, TEXT.replace(old, new))
    monkeypatch.setattr(configuring, "ANSWER_S", 0.01)
    made.remotes["module"].sdo.RESPONSE_TIMEOUT = 0.01

    def check_and_apply() -> None:
        made.check_identity()
        made.apply()

    with pytest.raises(configuring.NetworkError) as error:
        check_and_apply()
    assert str(error.value).startswith(said)
    assert network.values() == before


@pytest.mark.parametrize("refused", [0x6000, 0x1A00, 0x1800, 0x1016, 0x1017])
def test_a_failure_undoes_what_was_written(tmp_path: Path, refused: int) -> None:
    """Wherever it fails, every object is what it was, and the nodes are PRE-OPERATIONAL."""
    network = Network()
    for node in (0x11, 0x21):
        network.network.send_message(0, bytes([1, node]))
    made = configuration(network, tmp_path)
    before = network.values()
    sdo = made.remotes["module"].sdo
    download, counted = sdo.download, []

    def failing(index: int, subindex: int, data: bytes) -> None:
        counted.append(index)
        if index == refused and counted.count(index) == 1 + (index in (0x1A00, 0x1800)):
            raise configuring.SdoAbortedError(0x08000022)
        download(index, subindex, data)

    sdo.download = failing
    with pytest.raises(configuring.NetworkError, match=f"{refused:04X}:.*08000022h"):
        made.apply()
    changed = {place: value for place, value in network.values().items() if value != before[place]}
    assert changed == {}
    assert network.module.state is NmtState.PRE_OPERATIONAL
    assert network.interface.state is NmtState.PRE_OPERATIONAL


def test_what_a_node_does_not_take_is_noticed(tmp_path: Path) -> None:
    network = Network()
    made = configuration(network, tmp_path)
    made.remotes["module"].sdo.download = lambda index, subindex, data: None
    with pytest.raises(configuring.NetworkError, match=r"2001:01: written 00000400h, reads 000009C4h"):
        made.apply()


def test_saved_parameters_survive_a_reset(tmp_path: Path) -> None:
    store = MemoryStore()
    network = Network(store)
    text = TEXT.replace("    eds: canfb-module.eds\n", SAVED)
    configuration(network, tmp_path, text).apply()
    assert store.images
    network.network.send_message(0, bytes([0x81, MODULE_ID]))
    made = configuration(network, tmp_path, text)
    assert [line for line in made.compare() if line.startswith("module")] == []
    kept = dict(store.images)
    made.apply()
    assert store.images == kept
