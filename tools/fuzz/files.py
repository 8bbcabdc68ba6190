"""Files from outside: an input is the number of a reader in READERS, and the content of its file.

A reader returns for a file that it accepts, and otherwise raises one of its refusals, with one line of text.
The initial inputs are small files written by the program itself, or from eds/ and docs/.
"""

import io
import json
import re
import struct
import tempfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import can
import numpy as np

from canfb import CanfbError, FeedbackModule, Frame, ModuleConfig, StateFiles, eds_path
from canfb.configuration import ANY_NODES, changed_module, load_config
from canfb.device.od.dcf import decode_concise, encode_concise
from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.storage import MemoryStore
from canfb.logs.log_replay import ReplayOptions, replay_log
from canfb.master.samples import read_npz
from canfb.module.device_configuration import configuration_of
from canfb.sdo.backups import Backup, NodeIdentity, backup_text, read_backup
from canfb.sdo.object_description import ObjectDescriptions
from canfb.sdo.tables import as_yaml, read_table
from canfb.signal.conditioning import IDENTITY, Conditioning
from canfb.signal.correction import Correction, CorrectionTable
from canfb.sources.recording_source import RecordingLayout, open_recording
from tools.fuzz import body
from tools.fuzz.bounds import bounded
from tools.fuzz.inputs import NODE_ID
from tools.fuzz.sdo import demand

SAMPLES = 20
"""That are taken of a simulated source, or a recording."""
LONGEST_MESSAGE = 1000
"""Characters of a refusal."""
TABLE = CorrectionTable(np.arange(16) / 16 + 0.01 * np.sin(np.arange(16) * np.pi / 8))
BOMB = b"x:\n" + b"".join(
    b"- &b%d [%s]\n" % (n, b", ".join([b"*b%d" % (n - 1) if n else b"0.5"] * 9)) for n in range(9)
)
"""Nine lists of nine of the one before: short, and 387 million values when *b8 is written out."""
SECTIONS = {"FileInfo", "DeviceInfo", "DummyUsage", "Comments", "MandatoryObjects"}
SECTIONS |= {"1000", "1003", "1017", "1018", "1400", "1600", "2001", "2010", "2012", "2020", "6004"}
"""Those of the EDS that an input has: the whole file takes too long to be read a million times."""
DOCS = Path(__file__).parents[2] / "docs"
CONFIGURATION = """\
modules:
  - {node_id: 33, residual_limit: 0.3, corner_hz: 1e5, conditioning: {sine_offset_counts: 3}}
  - {node_id: 34, unlock_code: 5, source: {kind: recording, file: x, time_column: t, gap_s: 0.5}}
simulation: {encoder: {harmonics: [{order: 2, sine: 0.01, cosine: 0}]}, motion: {ripple_rpm: 1, ripple_hz: 2}}
"""
"""Keys that the examples of docs/ do not have."""
SETTINGS = """\
residual_limit=0.25
times=false
conditioning={sine_offset_counts: 3}
second_position={cob_id: 0x3B0}
serial_number=0x1234
adapt=true"""
COMPACT = """\
[DeviceInfo]
ProductName=x
[1003]
ParameterName=Errors
ObjectType=0x8
DataType=0x0007
CompactSubObj=8
[1003Value]
NrOfEntries=1
1=5
[2000]
ParameterName=Way
DataType=0x0008
AccessType=rww
DefaultValue=1.5
HighLimit=5
"""


class NotOneLineError(Exception):
    """A refusal that the command line could not print as one line."""


@dataclass(frozen=True)
class Reader:
    """A reader of files that end with ``suffix``: ``read``, its refusals, and ``begin``: good files."""

    suffix: str
    read: Callable[[Path], object]
    begin: Callable[[], list[bytes]]
    refusals: tuple[type[Exception], ...] = (CanfbError,)


def play(data: bytes, folder: Path) -> bool:
    """Play an input; False: it was properly refused. Raises findings, also BeyondBoundsError."""
    reader = READERS[data[0] % len(READERS) if data else 0]
    path = folder / f"input{reader.suffix}"
    path.write_bytes(data[1:])
    try:
        with bounded(folder):
            reader.read(path)
    except reader.refusals as error:
        text = str(error)
        is_line = bool(text) and len(text) <= LONGEST_MESSAGE and len(text.splitlines()) == 1
        if "MemoryError" in text or (isinstance(error, CanfbError) and not is_line):
            raise NotOneLineError(f"{len(text)} characters: {text}") from error
        return False
    return True


def seeds() -> list[bytes]:
    return [bytes([number]) + data for number, reader in enumerate(READERS) for data in reader.begin()]


def _eds(path: Path) -> None:
    for entry in Dictionary.load(path, NODE_ID):
        demand(entry.index or entry.name is not None, "an object without a name")


def _some_eds() -> list[bytes]:
    parts = eds_path("canfb-module").read_text(encoding="utf-8").split("\n[")
    kept = [part for part in parts[1:] if part.split("]")[0].split("sub")[0] in SECTIONS]
    return ["\n[".join([parts[0], *kept]).encode(), COMPACT.encode()]


def _concise(path: Path) -> None:
    data = path.read_bytes()
    demand(sum(len(one.data) for one in decode_concise(data)) <= len(data), "more than there is")


def _configuration(path: Path) -> None:
    config = load_config(path, ANY_NODES)
    for module in config.modules[:3]:
        FeedbackModule(module, source=None if module.source is None else body.Turning()).start(0.0)
    source = config.simulation.source(12, 2500, 1e-3)
    for _ in range(SAMPLES):
        source.next()


def _configurations() -> list[bytes]:
    pages = "".join(page.read_text(encoding="utf-8") for page in DOCS.glob("*.md"))
    examples = re.findall(r"^```yaml\n(.*?)^```", pages, re.MULTILINE | re.DOTALL)
    bomb = BOMB + b"bus: {channel: *b8}\nmodules: [{node_id: 1}]\n"
    return [*(one.encode() for one in [CONFIGURATION, *sorted(examples)]), bomb]


def _settings(path: Path) -> None:
    said = path.read_bytes().decode("utf-8", errors="surrogateescape")
    changed_module(ModuleConfig(node_id=NODE_ID), said.split("\n")[:20])


def _table(path: Path) -> None:
    used = read_table(path).for_module(IDENTITY)
    again = path.with_suffix(".yaml")
    again.write_text(as_yaml(used, {}), encoding="utf-8")
    demand(read_table(again).used == used, "a table that is written is not the one that was read")


def _tables() -> list[bytes]:
    conditioned = Correction(TABLE, Conditioning(sine_offset_counts=2.0, cosine_gain=1.01, delay_s=1e-6))
    texts = (as_yaml(conditioned, {"date": "2026-01-02"}), as_yaml(Correction(TABLE), {}))
    return [*(text.encode() for text in texts), BOMB + b"entries: *b8\n"]


@cache
def _objects() -> ObjectDescriptions:
    return ObjectDescriptions(eds_path("canfb-module"), NODE_ID)


def _backup(path: Path) -> None:
    kept = read_backup(path, _objects())
    path.write_text(backup_text(kept, _objects()), encoding="utf-8")
    again = read_backup(path, _objects())
    demand((again.table, set(again.values)) == (kept.table, set(kept.values)), "a backup of a backup differs")


def _module(store: MemoryStore | None = None) -> FeedbackModule:
    module = FeedbackModule(ModuleConfig(node_id=NODE_ID, residual_limit=0.25), store)
    module.start(0.0)
    return module


def _backups() -> list[bytes]:
    values = {key: one for key, one in configuration_of(_module()).values().items() if key[0] < 0x2012}
    identity = NodeIdentity(0, 1, 0x00010000, 7)
    kept = Backup(NODE_ID, identity, "2026-01-02", "0.2.0", "canfb", values, TABLE.to_bytes(), {})
    text = backup_text(kept, _objects()).encode()
    return [text, BOMB + text.partition(b"parameters:")[0] + b"parameters: *b8\n"]


def _csv(path: Path) -> None:
    for time in (None, "t"):
        layout = RecordingLayout(("sine", "cosine"), 0.0, time, time_stamps=True, paced=True)
        source = open_recording(path, layout)
        for _ in range(min(SAMPLES, len(source.tracks[0]))):
            source.next()


def _recordings() -> list[bytes]:
    rows = [f"{n * 1e-3 + 0.5 * (n > 20):.4f},{1000 + n * 7},{n * -13}" for n in range(30)]
    return ["\n".join(["t,sine,cosine", *rows]).encode(), b'sine , "cosine",t\r\n1,2,0\r\n3e1,-4.5,0.1\r\n']


def _arrays() -> list[bytes]:
    sine, cosine = (np.arange(40, dtype=np.int16) * step for step in (90, -70))
    packed, plain = io.BytesIO(), io.BytesIO()
    times: Any = {"rate_hz": 1000.0, "time_s": np.arange(40) * 1e-3, "cycles_per_s": 5.0}
    np.savez_compressed(packed, sine=sine, cosine=cosine, **times)
    np.savez(plain, sine=sine.astype(float), cosine=cosine.astype(float))
    return [packed.getvalue(), plain.getvalue()]


def _log(path: Path) -> None:
    log, results = replay_log(path, ReplayOptions((ModuleConfig(node_id=NODE_ID),)))
    demand("MemoryError" not in (log.trouble or ""), "it takes all memory")
    json.dumps([(result.lines(), result.figures()) for result in results], allow_nan=False)


def _logs(suffix: str, **options: Any) -> Callable[[], list[bytes]]:
    """Frames of all kinds, as python-can writes them."""

    def made() -> list[bytes]:
        frames = [(0x080, b""), (0x190, b"\xe8\x03\x00\x00"), (0x1A0, bytes(8)), (0x720, b"\x05")]
        heard = [
            can.Message(timestamp=1.7e9 + n / 1000, arbitration_id=one, data=data, is_extended_id=False)
            for n in range(10)
            for one, data in frames
        ]
        others = [can.Message(timestamp=1.7e9 + 1, arbitration_id=0x18FF0001, data=b"12", channel=1)]
        if suffix != ".trc":  # its writer supports no other frames
            others += [
                can.Message(timestamp=1.7e9 + 2, arbitration_id=0x7A0, is_remote_frame=True, dlc=3),
                can.Message(timestamp=1.7e9 + 3, is_error_frame=True),
                can.Message(timestamp=1.7e9 + 4, arbitration_id=0x123, data=bytes(12), is_fd=True),
            ]
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, f"a{suffix}")
            with can.Logger(path, **options) as writer:
                for message in heard[:20] + others + heard[20:]:
                    writer.on_message_received(message)
            return [path.read_bytes()]

    return made


def _state(path: Path) -> None:
    """A damaged parameters.bin in a state_dir, with a correct CRC: the module must start, work, and save."""
    data, folder = path.read_bytes(), path.parent / "state"
    folder.mkdir(exist_ok=True)
    sealed = data[:-4] + struct.pack("<I", zlib.crc32(data[:-4]))
    (folder / "communication.bin").write_bytes(sealed if len(data) > 4 else data)
    with StateFiles(folder) as files:
        run = body.Play(FeedbackModule(ModuleConfig(node_id=NODE_ID), files))
        run.start()
        run.check_values()
        run.check_alive()
        sent = run.receive(Frame(0x600 + run.node_id, b"\x23\x10\x10\x01save"))
        demand(any(frame.data[:1] == b"\x60" for frame in sent), "it does not save")


def _states() -> list[bytes]:
    store = MemoryStore()
    _module(store).receive(Frame(0x600 + NODE_ID, b"\x23\x10\x10\x01save"), 0.1)
    return list(store.images.values())


READERS = (
    Reader(".eds", _eds, _some_eds, (CanfbError, ValueError)),
    Reader(".dcf", _concise, lambda: [encode_concise(configuration_of(_module()).writes())], (ValueError,)),
    Reader(".yaml", _configuration, _configurations),
    Reader(".txt", _settings, lambda: [SETTINGS.encode()]),
    Reader(".yaml", _table, _tables),
    Reader(".bin", _table, lambda: [TABLE.to_bytes()]),
    Reader(".yaml", _backup, _backups),
    Reader(".csv", _csv, _recordings),
    Reader(".npz", read_npz, _arrays),
    *(Reader(suffix, _log, _logs(suffix)) for suffix in (".log", ".log.gz", ".asc", ".trc", ".csv", ".db")),
    Reader(".blf", _log, _logs(".blf", compression_level=0)),
    Reader(".bin", _state, _states, ()),
)
