"""What the inputs of each target begin with: small files, made by the program that reads them."""

from __future__ import annotations

import io
import json
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import can
import numpy as np

from canfb.backup.backup_file import Backup, NodeIdentity, backup_text
from canfb.cia301.frame import Frame
from canfb.cli.config_file import EXAMPLE
from canfb.configuration import Config
from canfb.device.od.dcf import Commissioning, FileInfo, dcf_text
from canfb.device.od.writes import encode_concise
from canfb.device.storage.image import ParameterGroup
from canfb.device.storage.storage import MemoryStore
from canfb.eds_files import eds_path
from canfb.hosting.state_files import StateFiles
from canfb.interface.encoder_interface import EncoderInterface
from canfb.logs.log_replay import COLUMNS
from canfb.module.device_configuration import configuration_of
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.layout import assumed_layout, known_layouts
from canfb.monitoring.snapshot import BusSnapshot
from canfb.sdo.object_description import ObjectDescriptions
from canfb.signal.conditioning import Conditioning
from canfb.signal.correction import Correction, CorrectionTable
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.encoder import ShaftEncoder, demo_encoder
from canfb.simulation.motion import Motion, Ramp
from canfb.simulation.scenario import SimulationConfig
from canfb.simulation.sync_producer import SyncProducer
from canfb.sources.motion_source import MotionSource
from canfb.tables.table_file import as_yaml

NODE, INTERFACE = 0x20, 0x10
PERIOD_S = 1e-3
TABLE = CorrectionTable(np.arange(16) / 16 + 0.01 * np.sin(np.arange(16) * np.pi / 8))
BOMB = b"x:\n" + b"".join(
    b"- &b%d [%s]\n" % (n, b", ".join([b"*b%d" % (n - 1) if n else b"0.5"] * 9)) for n in range(9)
)
"""Nine lists of nine of the one before: short, and 387 million values when *b8 is written out."""
SECTIONS = {"FileInfo", "DeviceInfo", "DummyUsage", "DeviceComissioning", "Comments", "MandatoryObjects"}
SECTIONS |= {"1000", "1003", "1017", "1018", "1400", "1600", "2001", "2010", "2012", "2020", "6004"}
"""Those of the EDS that an input has: the whole file takes too long to be read a million times."""


INFO = FileInfo(file_name="a.dcf", description="", date="01-02-2026", time="01:02AM")
PLACE = Commissioning(
    node_id=NODE, node_name="left", bit_rate_kbit_s=500, network_name="CAN", serial_number=7
)


def text_seeds(*texts: str) -> list[bytes]:
    """Of texts."""
    return [text.encode() for text in texts]


def abridged(text: str) -> bytes:
    """An EDS or DCF with some of its objects."""
    parts = text.replace("\r\n", "\n").split("\n[")
    kept = [part for part in parts[1:] if part.split("]")[0].split("sub")[0] in SECTIONS]
    return "\n[".join([parts[0], *kept]).encode()


def eds() -> list[bytes]:
    """Ours, and one in the compact form."""
    names = ("canfb-module", "encoder-interface", "drive")
    files = [abridged(eds_path(name).read_text(encoding="utf-8")) for name in names]
    compact = (
        "[DeviceInfo]\nVendorNumber=0\nProductName=x\n[1003]\nParameterName=Errors\nObjectType=0x8\n"
        "DataType=0x0007\nAccessType=ro\nCompactSubObj=8\n[1003Name]\nNrOfEntries=1\n1=First\n[1003Value]\n"
        "NrOfEntries=1\n1=5\n;Unit=mm\n[2000]\nParameterName=Way\nDataType=0x0008\nAccessType=rww\n"
        "DefaultValue=1.5\nLowLimit=-1\nHighLimit=5\n[2001]\nParameterName=D\nObjectType=2\n"
    )
    return [*files, compact.encode()]


def dcf() -> list[bytes]:
    """Of a module with other values than the factory defaults."""
    configuration = configuration_of(_module())
    return [abridged(dcf_text(eds_path("canfb-module"), INFO, PLACE, configuration.values()))]


def concise() -> list[bytes]:
    """The same as its bytes."""
    return [encode_concise(configuration_of(_module()).writes())]


def _module() -> FeedbackModule:
    module = FeedbackModule(ModuleConfig(node_id=NODE, residual_limit=0.25))
    module.start(0.0)
    return module


def configuration() -> list[bytes]:
    """The example, and one with all that it leaves out."""
    full = """\
bus: {interface: virtual, channel: x, bitrate: 500000, receive_own_messages: true}
modules:
  - {node_id: 33, encoder_interface: 16, cycles_per_revolution: 2500, adc_bits: 14, times: true,
     autostart: true, max_acceleration_rad_s2: 1e3, residual_limit: 0.3, coast_samples: 3,
     conditioning: {sine_offset_counts: 3, cosine_gain: 1.01, cosine_delay_s: 1e-6}, adapt: true,
     corner_hz: 125e3,
     second_position: {cob_id: 0x3B0, increments: 65536, tolerance_revolutions: 0.01},
     samples_per_sync: 2}
  - node_id: 255
    serial_number: 12
    source: {kind: motion}
    write_lock: code
    unlock_code: 5
interfaces:
  - {node_id: 17, source: {kind: recording, file: /dev/null, columns: [sine, 1], time_column: t, gap_s: 0.5}}
realtime: {priority: 80, lock_memory: false, cpu: 0}
simulation:
  encoder: {amplitude: 0.7, phase_error_rad: 0.02, harmonics: [{order: 2, sine: 0.01, cosine: 0}]}
  motion: {standstill_s: 0.1, ramp_s: 1, rpm: 300, ripple_rpm: 1, ripple_hz: 2}
  drive: {node_id: 0x30}
  sync_jitter_us: 5
  seed: 3
"""
    bomb = BOMB + b"bus: {channel: *b8}\nmodules: [{node_id: 1}]\n"
    return [*text_seeds(EXAMPLE, full, "modules: [{node_id: 1, corner_hz: 1e5}]\n"), bomb]


def planned() -> list[bytes]:
    """Configurations that take little time."""
    return text_seeds(
        "bus: {bitrate: 500000}\nmodules:\n- {node_id: 1, corner_hz: 1e5, times: true}\n",
        "modules: [{node_id: 255, samples_per_sync: 2}]\n"
        "simulation: {motion: {rpm: 300, ramp_s: 1}, sync_period_us: 500}\n",
    )


def settings() -> list[bytes]:
    """KEY=VALUE of --set, a line each."""
    return text_seeds(
        "residual_limit=0.25\nadapt=true\ntimes=false\nmax_acceleration_rad_s2=1e3",
        "conditioning={sine_offset_counts: 3, cosine_gain: 1.5}\nsecond_position={cob_id: 0x3B0}",
        "node_id=33\nserial_number=0x1234\nstate_dir=/tmp/x\nadapt={every: 5}",
    )


def table_yaml() -> list[bytes]:
    """With conditioning, and without."""
    conditioned = Correction(TABLE, Conditioning(sine_offset_counts=2.0, cosine_gain=1.01, delay_s=1e-6))
    meta: dict[str, Any] = {
        "date": "2026-01-02",
        "cycles_per_revolution": 2500,
        "module_identity": {"vendor": 1},
    }
    texts = (as_yaml(conditioned, meta), as_yaml(Correction(CorrectionTable.identity(16)), {}))
    return [*text_seeds(*texts), BOMB + b"entries: *b8\n"]


def table_bytes() -> list[bytes]:
    """Object 2020:01."""
    return [TABLE.to_bytes(), CorrectionTable.identity(64).to_bytes()]


def backup() -> list[bytes]:
    """Of a module, with its table."""
    described = ObjectDescriptions(eds_path("canfb-module"), NODE)
    values = {
        place: value for place, value in configuration_of(_module()).values().items() if place[0] < 0x2012
    }
    identity = NodeIdentity(0, 1, 0x00010000, 7)
    of_machine = {(0x6003, 0): 5}
    text = backup_text(
        Backup(NODE, identity, "2026-01-02", "0.2.0", "canfb", values, TABLE.to_bytes(), of_machine),
        described,
    )
    bomb = BOMB + text.partition("parameters:")[0].encode() + b"parameters: *b8\n"
    return [text.encode(), bomb]


def recording_csv() -> list[bytes]:
    """With and without times, with a gap."""
    rows = [f"{n * 1e-3 + 0.5 * (n > 20):.4f},{1000 + n * 7},{n * -13}" for n in range(30)]
    return text_seeds("\n".join(["t,sine,cosine", *rows]), 'sine , "cosine",t\r\n1,2,0\r\n3e1,-4.5,0.1\r\n')


def npz() -> list[bytes]:
    """Compressed, and as it is."""
    sine, cosine = (np.arange(40, dtype=np.int16) * step for step in (90, -70))
    arrays: dict[str, Any] = {
        "sine": sine,
        "cosine": cosine,
        "rate_hz": 1000.0,
        "time_s": np.arange(40) * 1e-3,
    }
    packed, plain = io.BytesIO(), io.BytesIO()
    np.savez_compressed(packed, **arrays, origin=np.array("x"), cycles_per_s=5.0)
    np.savez(plain, sine=sine.astype(float), cosine=cosine.astype(float))
    return [packed.getvalue(), plain.getvalue()]


def npy() -> list[bytes]:
    """Arrays of an NPZ before they are packed: name, a NUL, and the file, NPY_END between them."""
    parts = []
    arrays = {"sine": np.arange(8) * 9.0, "cosine": np.arange(8) * -7.0, "rate_hz": np.full((), 1000.0)}
    for name, values in arrays.items():
        file = io.BytesIO()
        np.save(file, values)
        parts.append(name.encode() + b"\0" + file.getvalue())
    return [NPY_END.join(parts)]


NPY_END = b"\n--\n"


@cache
def _traffic() -> tuple[list[tuple[float, Frame]], BusSnapshot]:
    """A module and its interface at 1 kHz for 0.1 s: the frames, and what a monitor has seen of them."""
    frames: list[tuple[float, Frame]] = []
    config = ModuleConfig(node_id=NODE, autostart=True)
    model = BusModel(known_layouts(Config(modules=[config]), (NODE,)), assumed_layout, 1_000_000)

    def hear(frame: Frame, now: float) -> None:
        frames.append((now, frame))
        model.receive(frame, now)

    bus = EmbeddedBus(1_000_000)
    bus.observers.append(hear)
    shaft = ShaftEncoder(demo_encoder(), 2500, 1, 0.0)
    bus.attach(FeedbackModule(config))
    source = MotionSource(shaft, Motion((Ramp(0.02, 0.0), Ramp(0.5, 60.0)), ()), PERIOD_S)
    bus.attach(EncoderInterface(INTERFACE, source, autostart=True))
    bus.attach(SyncProducer(PERIOD_S, SimulationConfig(), 1))
    bus.run_until(0.1)
    return frames, model.snapshot(bus.now)


def snapshot() -> BusSnapshot:
    """What the page of the scope shows."""
    return _traffic()[1]


def log(suffix: str, **options: Any) -> Callable[[], list[bytes]]:
    """Logs with all kinds of frames, as python-can writes them."""

    def made() -> list[bytes]:
        heard = [
            can.Message(
                timestamp=1.7e9 + at, arbitration_id=f.can_id, data=f.data, is_extended_id=False, channel=0
            )
            for at, f in _traffic()[0][:40]
        ]
        others = [
            can.Message(timestamp=1.7e9 + 1, arbitration_id=0x18FF0001, data=b"12", channel=1),
            can.Message(
                timestamp=1.7e9 + 2, arbitration_id=0x7A0, is_remote_frame=True, is_extended_id=False, dlc=3
            ),
            can.Message(timestamp=1.7e9 + 3, is_error_frame=True, channel=0),
            can.Message(timestamp=1.7e9 + 4, arbitration_id=0x123, data=bytes(12), is_fd=True, channel=0),
        ]
        if suffix == ".trc":  # its writer knows no other frames
            others = others[:1]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, f"a{suffix}")
            with can.Logger(path, **options) as writer:
                for message in heard[:20] + others + heard[20:]:
                    writer.on_message_received(message)
            return [path.read_bytes()]

    return made


def states() -> list[bytes]:
    """The number of a file of STATE_FILES, and its content as a module has saved it."""
    store = MemoryStore()
    module = FeedbackModule(ModuleConfig(node_id=NODE), store)
    module.start(0.0)
    module.receive(Frame(0x600 + NODE, b"\x23\x10\x10\x01save"), 0.1)
    images = [
        bytes([STATE_FILES.index(f"{group.name.lower()}.bin")]) + image
        for group, image in store.images.items()
    ]
    with tempfile.TemporaryDirectory() as folder, StateFiles(folder) as files:
        files._finish = lambda changes: None  # type: ignore[method-assign]
        files.save({**store.images, ParameterGroup.LSS: None})
        pending = Path(folder, "pending.bin").read_bytes()
    return [*images, bytes([STATE_FILES.index("pending.bin")]) + pending]


STATE_FILES = [*(f"{group.name.lower()}.bin" for group in ParameterGroup), "pending.bin"]


def notes() -> list[bytes]:
    """What an interrupted replay of a folder has noted."""
    row: dict[str, Any] = dict.fromkeys(COLUMNS) | {
        "log": "a.log",
        "module": 32,
        "frames": 5,
        "fingerprint": "$FINGERPRINT",
    }
    return text_seeds(
        "".join(f"{json.dumps(row | {'log': name})}\n" for name in ("a.log", "b.log")) + '{"log": "c'
    )


def requests() -> list[bytes]:
    """Requests of a browser to the scope: $HOST, $TOKEN and $TICKET stand for what it knows."""
    base = "Host: $HOST\nOrigin: http://$HOST\nCookie: a=b\n"
    return text_seeds(
        f"GET /\n{base}",
        f"POST /session\n{base}Authorization: Bearer $TOKEN\n",
        f"GET /live/ws\n{base}Upgrade: websocket\nSec-WebSocket-Protocol: bokeh, $TICKET\n",
    )


def messages() -> list[bytes]:
    """What a browser sends to the page, an event a line; $name stands for the id of the part of this name."""

    def changed(name: str, attribute: str, new: Any) -> str:
        model = {"id": f"${name}"}
        return json.dumps({"kind": "ModelChanged", "model": model, "attr": attribute, "new": new})

    def clicked(name: str) -> str:
        event = {"type": "map", "entries": [["model", {"id": f"${name}"}]]}
        data = {"type": "event", "name": "button_click", "values": event}
        return json.dumps({"kind": "MessageSent", "msg_type": "bokeh_event", "msg_data": data})

    number = {"type": "ndarray", "array": "AAAA", "dtype": "uint8", "shape": [3], "order": "little"}
    lines: Sequence[Sequence[str]] = (
        [changed("select", "value", "32"), changed("dark", "active", True), clicked("Read table")],
        [changed("file", "filename", "a.bin"), changed("file", "value", "AAECAwQ="), clicked("Upload table")],
        [clicked("Save"), changed("code", "value", "ABCD-EFGH"), clicked("yes"), clicked("no")],
        [clicked("Activate"), changed("head", "text", {"type": "number", "value": "nan"}), clicked("yes")],
        [
            json.dumps({"kind": "TitleChanged", "title": "x"}),
            json.dumps({"kind": "RootRemoved", "model": {"id": "$head"}}),
        ],
        [changed("select", "options", [["1", "a"]]), changed("select", "value", number)],
    )
    return text_seeds(*("\n".join(one) for one in lines))
