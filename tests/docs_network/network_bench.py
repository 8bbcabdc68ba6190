"""A small network file and its nodes on an embedded bus, with python canopen as master."""

from pathlib import Path
from typing import Any

from canfb import FeedbackModule, Frame, ModuleConfig, eds_path
from canfb.demo.story import EmbeddedNetwork
from canfb.device.storage.storage import Store
from canfb.interface.encoder_interface import EncoderInterface
from canfb.simulation.embedded_bus import EmbeddedBus
from played import Still

INTERFACE_ID, MODULE_ID = 0x11, 0x21
EDS_FOLDER = eds_path("canfb-module").parent

TEXT = f"""\
bus: {{interface: socketcan, channel: vcan0}}
eds_folder: {EDS_FOLDER}
sync_period_us: 10000
master: {{node_id: 1, heartbeat_ms: 200}}
nodes:
  - name: interface
    node_id: 0x11
    eds: encoder-interface.eds
    expect: {{device_type: 0x00040191, product_code: 2}}
    heartbeat_ms: 100
  - name: module
    node_id: 0x21
    eds: canfb-module.eds
    expect: {{device_type: 0x00040196, vendor_id: 0, product_code: 1, revision: 1}}
    heartbeat_ms: 100
    watches: {{interface: 300, master: 1000}}
    parameters:
      2001:01: 1024
      Supervision.Largest acceleration: 12.5
      6000: 4
      6001: 65536
      6002: 0x40000000
links:
  - name: ADC counts
    cob_id: 0x191
    from: {{node: interface, tpdo: 1, type: 1, map: [6401:01, 6401:02]}}
    to: [{{node: module, rpdo: 1, type: 255, map: [2000:01, 2000:02]}}]
  - name: position
    cob_id: 0x1A1
    from: {{node: module, tpdo: 1, type: 254, inhibit_100us: 5, map: [6004, 2011:01]}}
    to: [master]
start: [interface, module]
"""


class Network:
    """The two nodes, powered on; every frame is in ``sent``."""

    def __init__(self, store: Store | None = None) -> None:
        self.bus = EmbeddedBus()
        self.sent: list[Frame] = []
        self.bus.observers.append(lambda frame, now: self.sent.append(frame))
        self.network = EmbeddedNetwork(self.bus)
        self.module = FeedbackModule(ModuleConfig(node_id=MODULE_ID, encoder_interface=INTERFACE_ID), store)
        self.interface = EncoderInterface(INTERFACE_ID, Still(0, 1500))
        for device in (self.interface, self.module):
            self.bus.attach(device)

    def value(self, index: int, subindex: int = 0) -> Any:
        return self.module.dictionary.entry(index, subindex).value

    def values(self) -> dict[tuple[int, int, int], Any]:
        """Every value that a master can write, of both nodes."""
        return {
            (node, entry.index, entry.subindex): entry.value
            for node, device in ((INTERFACE_ID, self.interface), (MODULE_ID, self.module))
            for entry in device.dictionary
            if "w" in entry.access and "r" in entry.access
        }


def write(folder: Path, text: str = TEXT) -> Path:
    path = folder / "network.yaml"
    path.write_text(text, encoding="utf-8")
    return path
