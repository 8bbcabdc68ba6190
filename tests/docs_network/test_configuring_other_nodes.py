"""docs/drive-network/configuring.py against nodes that are not ours: python canopen's own LocalNode."""

from __future__ import annotations

from pathlib import Path

import configuring
import network_file
from network_bench import EDS_FOLDER, TEXT, write
from story_bench import StoryNetwork

from canfb.demo.story import EmbeddedNetwork
from canfb.simulation.embedded_bus import EmbeddedBus


class Nodes:
    """Two canopen.LocalNode with our EDS files; ``written`` is what the module was told, in order."""

    def __init__(self) -> None:
        bus = EmbeddedBus()
        self.network = EmbeddedNetwork(bus)
        slaves = [StoryNetwork(bus), StoryNetwork(bus)]
        self.interface = slaves[0].create_node(0x11, str(EDS_FOLDER / "encoder-interface.eds"))
        self.module = slaves[1].create_node(0x21, str(EDS_FOLDER / "canfb-module.eds"))
        self.written: list[tuple[int, int, int]] = []
        self.module.add_write_callback(
            lambda index, subindex, od, data: self.written.append(
                (index, subindex, int.from_bytes(data, "little"))
            )
        )


def made(nodes: Nodes, folder: Path, text: str = TEXT) -> configuring.Configuration:
    return configuring.Configuration(nodes.network, network_file.load(write(folder, text)))


def test_all_is_written_in_order_and_read_back(tmp_path: Path) -> None:
    nodes = Nodes()
    configuration = made(nodes, tmp_path)
    configuration.check_identity()
    configuration.apply()
    assert nodes.module.get_data(0x2001, 1) == (1024).to_bytes(4, "little")
    assert nodes.module.get_data(0x1400, 1) == (0x191).to_bytes(4, "little")
    pdo = [one for one in nodes.written if one[0] in (0x1800, 0x1A00)]
    assert pdo == [
        (0x1800, 1, 0xC00001A1),
        (0x1A00, 0, 0),
        (0x1A00, 0, 2),
        (0x1800, 3, 5),
        (0x1800, 1, 0x400001A1),
    ]
    assert configuration.compare() == []
    nodes.written.clear()
    assert made(nodes, tmp_path).apply() == 0
    assert nodes.written == []
