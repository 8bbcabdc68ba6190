import struct
from typing import Any

import canopen

from canfb import CorrectionTable, FeedbackModule, Frame, ModuleConfig, eds_path
from canfb.demo.story import EmbeddedNetwork
from canfb.device.storage.storage import Store
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.sources.protocol import Source
from ideal_tracks import adc_pdo

SYNC = Frame(0x80, b"")


class Bench:
    """A module on an embedded bus with python canopen's master, and an encoder interface played by hand."""

    place: float  # for tests that turn it in steps
    stamped = False  # frames have the time of their reception

    def __init__(self, store: Store | None = None, source: Source | None = None, **fields: Any) -> None:
        self.bus = EmbeddedBus()
        self.heard: list[Frame] = []
        self.network = EmbeddedNetwork(self.bus)
        self.module = FeedbackModule(
            ModuleConfig(**{"node_id": 32, **fields}), store, source=source, bit_rates_kbit_s=(125, 500)
        )
        self.remote = canopen.RemoteNode(self.module.config.node_id, str(eds_path("canfb-module")))
        self.network.add_node(self.remote)
        self.sdo = self.remote.sdo
        self.bus.observers.append(lambda frame, now: self.heard.append(frame))
        self.bus.attach(self.module)
        self.interval_s = 1e-3

    def start(self, *before: str) -> None:
        """After these other NMT states, or resets."""
        for state in (*before, "OPERATIONAL"):
            self.remote.nmt.state = state

    def save(self, subindex: int = 1) -> None:
        self.sdo.download(0x1010, subindex, b"save")

    def load(self, subindex: int = 1) -> None:
        self.sdo.download(0x1011, subindex, b"load")

    def stage(self, table: CorrectionTable) -> None:
        self.sdo.download(0x2020, 1, table.to_bytes())

    def activate(self, table: CorrectionTable) -> None:
        self.stage(table)
        self.sdo[0x2020][3].raw = table.crc32

    def value(self, index: int, subindex: int = 0) -> Any:
        return self.module.dictionary.entry(index, subindex).current()

    def in_force(self) -> tuple[int, int, int]:
        """CRC of the staged table, CRC and entries of the active one: 2020:02, 04, 05."""
        return tuple(self.sdo[0x2020][subindex].raw for subindex in (2, 4, 5))

    def map_rpdo2(self, *objects: int) -> None:
        """RPDO2 with COB-ID 290h carries these objects."""
        self.sdo[0x1401][1].raw = 0x80000290
        self.sdo[0x1601][0].raw = 0
        for n, mapped in enumerate(objects, 1):
            self.sdo[0x1601][n].raw = mapped
        self.sdo[0x1601][0].raw = len(objects)
        self.sdo[0x1401][1].raw = 0x290

    def sync(self) -> list[Frame]:
        """The next SYNC; what the module sends upon it."""
        self.bus.run_until(self.bus.now + self.interval_s)
        return self.sent(SYNC)

    def sent(self, frame: Frame) -> list[Frame]:
        before = len(self.heard)
        given = frame._replace(timestamp=self.bus.now) if self.stamped else frame
        self.bus.send(given)
        return [heard for heard in self.heard[before:] if heard != given]

    def counts(self, sine: int, cosine: int) -> list[Frame]:
        return self.sent(Frame(0x190, struct.pack("<hh", sine, cosine)))

    def at(self, cycles: float, amplitude: float = 1500.0, samples: int = 1) -> tuple[int, int, int]:
        """So many SYNCs, each with a sample at this position: the fields of the last position PDO."""
        for _ in range(samples):
            self.sync()
            sent = self.sent(adc_pdo(cycles, amplitude))
        return self.position(sent)

    def follow(self, speed: float, first: int, after: int, amplitude: float = 1500.0) -> None:
        """Samples of these numbers of a machine that turns, cycles per sample."""
        for n in range(first, after):
            self.at(speed * n, amplitude)

    @staticmethod
    def position(frames: list[Frame]) -> tuple[int, int, int]:
        """6004h, status word, residual of the only position PDO among these frames."""
        (data,) = [frame.data for frame in frames if frame.can_id == 0x1A0]
        return struct.unpack("<IHH", data)

    def emergencies(self) -> list[int]:
        return [code for code, *_ in self.alarms()]

    def alarms(self) -> list[tuple[int, int, int]]:
        """Code, error register and first manufacturer byte of each EMCY."""
        return [struct.unpack_from("<HBB", frame.data) for frame in self.heard if frame.can_id == 0xA0]
