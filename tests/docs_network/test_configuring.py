"""docs/drive-network/configuring.py against our devices."""

from __future__ import annotations

from pathlib import Path

import configuring
import network_file
import pytest
from network_bench import MODULE_ID, TEXT, Network, write

from canfb.cia301.codes import NmtState
from canfb.device.storage.storage import MemoryStore


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
