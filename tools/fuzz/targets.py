"""The targets: what each of them is given, and what may come of it.

``play`` returns for an input that is accepted, and raises one of ``refusals`` for one that is refused.
Anything else is a find, and so is what bounds.py forbids, and a refusal in more than one line.
"""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from bokeh.document import Document
from bokeh.models import FileInput
from bokeh.protocol import Protocol
from tornado.httputil import HTTPHeaders, HTTPInputError

from canfb.backup.backup_file import backup_text, read_backup
from canfb.cia301.frame import Frame
from canfb.configuration import ANY_NODES, changed_module, load_config
from canfb.device.od.dcf import dcf_text
from canfb.device.od.dictionary import Dictionary
from canfb.device.od.writes import decode_concise
from canfb.eds_files import eds_path
from canfb.errors import CanfbError
from canfb.hosting.hosting import saved_configuration
from canfb.hosting.state_files import StateFiles
from canfb.logs.folder_replay import InThisProcess, do_work, work_of
from canfb.logs.log_replay import ReplayOptions, job_of, replay_log
from canfb.master.samples import read_npz, read_speed
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.monitoring.lines import MachineUnits
from canfb.planning.plan import Plan
from canfb.planning.plan_changes import changes_of
from canfb.planning.plan_input import PlanOptions, numbered, plan_input_of
from canfb.planning.plan_rows import plan_figures, plan_lines
from canfb.replay import summary_of_replay
from canfb.scope.desk import Desk, ScopeTask, allowed_tasks
from canfb.scope.gate import Gate, GateVerdict, Request
from canfb.scope.scope_page import LARGEST_FILE, ScopePage
from canfb.scope.traces import BusTraces
from canfb.sdo.object_description import ObjectDescriptions, _described
from canfb.sdo.object_values import parse_value
from canfb.signal.conditioning import IDENTITY
from canfb.sources.recording_source import RecordingLayout, RecordingSource
from canfb.tables.table_file import as_yaml, read_table_file
from tools.fuzz import body, seeds
from tools.fuzz.bounds import bounded
from tools.fuzz.inputs import NODE_ID, Reader, steps
from tools.fuzz.watch import demand

SAMPLES = 20
"""That are taken of a simulated source, or a recording."""
HEADER = '{"msgid": "1", "msgtype": "PATCH-DOC"}'
RENEWED = 100
FRAMES_LONGEST, LOG_LONGEST = 400, 1 << 12
"""Bytes: what is behind the reader takes time for each frame, and for each second between two."""
LONGEST_MESSAGE = 1000
"""Characters of a refusal."""
CORPUS_OF_FRAMES = Path(__file__).parents[2] / "tests" / "tools" / "fuzz_corpus.txt"


class NotOneLineError(Exception):
    """A refusal that the command line could not print as one line."""


@dataclass(frozen=True)
class Target:
    """A reader of something that comes from outside.

    name       in the command
    seeds      makes the inputs to begin with
    play       reads an input: a file, and its content
    refusals   exceptions that refuse it
    suffix     of the file
    longest    input, bytes
    sealed     the same input with its checksums right, so that what is behind them is reached
    story      what an input means, in lines
    """

    name: str
    seeds: Callable[[], list[bytes]]
    play: Callable[[Path, bytes], None]
    refusals: tuple[type[Exception], ...] = (CanfbError,)
    suffix: str = ""
    longest: int = 1 << 15
    sealed: Callable[[bytes], bytes] | None = None
    story: Callable[[bytes], Iterator[str]] | None = None

    def accepts(self, path: Path, data: bytes) -> bool:
        """False: the input is refused as it should be. Raises what is found, BeyondBoundsError too."""
        path.write_bytes(data)
        try:
            with bounded(path.parent):
                self.play(path, data)
        except self.refusals as error:
            text = str(error)
            is_line = bool(text) and len(text) <= LONGEST_MESSAGE and len(text.splitlines()) == 1
            if "MemoryError" in text or (isinstance(error, CanfbError) and not is_line):
                raise NotOneLineError(f"{len(text)} characters: {text}") from error
            return False
        return True


def _frames(path: Path, data: bytes) -> None:
    body.play(data)


def _story_of_frames(data: bytes) -> Iterator[str]:
    reader = Reader(data)
    yield f"device {reader.byte()}"
    for step in steps(reader):
        for frame in step.frames:
            remote = " remote" if frame.rtr else ""
            yield f"  {frame.can_id:03X}#{frame.data.hex().upper()}{remote}"
        if step.follow:
            yield f"  a client goes on, {step.follow} rounds, and writes {len(step.content)} bytes"
        if step.pause_s:
            yield f"  {step.pause_s} s{' with ticks when they are due' if step.punctual else ''}"


def kept_frames() -> list[bytes]:
    """The inputs of the frames that are kept in the repository."""
    lines = CORPUS_OF_FRAMES.read_text(encoding="ascii").splitlines()
    return [bytes.fromhex(line.split()[0]) for line in lines if line and not line.startswith("#")]


def _eds(path: Path, data: bytes) -> None:
    """As ``canfb sdo --eds`` reads it, and what it then does with each object."""
    _described.cache_clear()  # two inputs may come within the resolution of the time of a file
    described = ObjectDescriptions(path, NODE_ID)
    for entry in described:
        demand(entry.number and entry.title is not None, "an object without a name")
        described.meant(entry.number)
        for said in ("1", "-0.5", "text", "00FF"):
            try:
                parse_value(entry.data_type, said, entry.low, entry.high)
            except ValueError:
                continue
        for length in (0, 1, 4, 8):
            try:
                entry.decode(bytes(length))
            except ValueError:
                continue


def _dcf(path: Path, data: bytes) -> None:
    """As a device reads it, and as ``canfb config dcf`` fills it in."""
    dictionary = Dictionary.load(path, NODE_ID)
    info, place = seeds.INFO, seeds.PLACE
    values = {(entry.index, entry.subindex): entry.value for entry in dictionary if entry.access == "rw"}
    dcf_text(path, info, place, {where: value for where, value in values.items() if value is not None})


def _concise(path: Path, data: bytes) -> None:
    writes = decode_concise(data)
    demand(sum(len(one.data) for one in writes) <= len(data), "more than there is")


def _configuration(path: Path, data: bytes) -> None:
    """As all commands read it; the devices of it are made."""
    config = load_config(path, ANY_NODES)
    for module in config.modules[:3]:
        device = FeedbackModule(module, source=None if module.source is None else _Silent())
        device.start(0.0)
    source = config.simulation.source(12, 2500, 1e-3)
    for _ in range(SAMPLES):
        source.next()


class _Silent:
    def next(self) -> None:
        """No sample."""


def _plan(path: Path, data: bytes) -> None:
    """As ``canfb plan``; ValueError of what it computes is told as one of its options."""
    config = numbered(load_config(path))
    modules = [saved_configuration(one) for one in config.modules[:3]]
    plan = Plan(plan_input_of(replace(config, modules=config.modules[:3]), modules, PlanOptions()))
    changes = changes_of(plan)
    plan_lines(plan, changes, coverage=data[-1:] == b"#")
    json.dumps(plan_figures(plan, changes), allow_nan=False)


def _settings(path: Path, data: bytes) -> None:
    changed_module(
        ModuleConfig(node_id=NODE_ID), data.decode("utf-8", errors="surrogateescape").split("\n")[:20]
    )


def _table(path: Path, data: bytes) -> None:
    file = read_table_file(path)
    used = file.for_module(IDENTITY)
    path.write_text(as_yaml(used, {}), encoding="utf-8")
    again = read_table_file(path) if path.suffix == ".yaml" else None
    demand(again is None or again.used == used, "a table that is written is not the one that was read")


@cache
def _objects() -> ObjectDescriptions:
    return ObjectDescriptions(eds_path("canfb-module"), NODE_ID)


def _backup(path: Path, data: bytes) -> None:
    kept = read_backup(path, _objects(), accept_unknown=data[-1:] == b"#")
    path.write_text(backup_text(kept, _objects()), encoding="utf-8")
    again = read_backup(path, _objects())
    demand(
        again.table == kept.table and set(again.values) == set(kept.values), "a backup of a backup differs"
    )


def _csv(path: Path, data: bytes) -> None:
    for time in (None, "t"):
        source = RecordingSource(
            path, RecordingLayout(("sine", "cosine"), 0.0, time, time_stamps=True, paced=True)
        )
        source.tracks()
        for _ in range(min(SAMPLES, len(source))):
            source.next()


def _npz(path: Path, data: bytes) -> None:
    read_npz(path)
    read_speed(path)


def _npy(path: Path, data: bytes) -> None:
    """The arrays are changed, and the ZIP file around them is right."""
    arrays = {part.partition(b"\0")[0][:20]: part.partition(b"\0")[2] for part in data.split(seeds.NPY_END)}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, array in arrays.items():
            file.writestr(zipfile.ZipInfo(f"{name.decode('latin-1')}.npy"), array)
    _npz(path, data)


def _log(path: Path, data: bytes) -> None:
    """As ``canfb replay`` reads it, through a module."""
    done = replay_log(path, ReplayOptions((ModuleConfig(node_id=NODE_ID),)))
    demand("MemoryError" not in (done.log.trouble or ""), "it takes all memory")
    for replay in done.replays:
        summary_of_replay.lines(replay, None, done.left_out(replay))
        json.dumps(summary_of_replay.figures(replay, None, done.left_out(replay)), allow_nan=False)


def _state(path: Path, data: bytes) -> None:
    """A module with a damaged file in its state_dir: it starts, works, and saves."""
    folder = path.parent / "state"
    folder.mkdir(exist_ok=True)
    for name in seeds.STATE_FILES:
        (folder / name).unlink(missing_ok=True)
    (folder / seeds.STATE_FILES[data[0] % len(seeds.STATE_FILES) if data else 0]).write_bytes(data[1:])
    with StateFiles(folder) as files:
        run = body.Play(FeedbackModule(ModuleConfig(node_id=NODE_ID), files))
        run.start()
        run.check_values()
        run.check_alive()
        sent = run.receive(Frame(0x600 + run.node_id, b"\x23\x10\x10\x01save"))
        demand(any(frame.data[:1] == b"\x60" for frame in sent), "it does not save")


def _seal_state(data: bytes) -> bytes:
    return data[:-4] + struct.pack("<I", zlib.crc32(data[1:-4])) if len(data) > 5 else data


@cache
def _replay_settings() -> ReplayOptions:
    return ReplayOptions((ModuleConfig(node_id=NODE_ID),))


def _notes(path: Path, data: bytes) -> None:
    """What is left of an interrupted replay of a folder; its logs are noted as done."""
    folder, settings = path.parent / "logs", _replay_settings()
    folder.mkdir(exist_ok=True)
    for name in ("a.log", "b.log"):
        if not (folder / name).exists():
            (folder / name).write_bytes(b"(1.0) can0 080#\n(1.0) can0 190#00000000\n")
    known = job_of(folder, folder / "a.log", settings).fingerprint
    out = path.parent / "out.parquet"
    out.unlink(missing_ok=True)
    Path(f"{out}.unfinished").write_bytes(data.replace(b"$FINGERPRINT", known.encode()))
    do_work(work_of(folder, settings, out), settings, None, InThisProcess())


def _request(path: Path, data: bytes) -> None:
    """A request of HTTP: nothing with a secret is answered without it."""
    gate = Gate(5006, ("/",), token="right")
    gate.issue("ticket")
    text = data.decode("latin-1").replace("$HOST", "127.0.0.1:5006")
    secret = "$TOKEN" in text or "$TICKET" in text or "right" in text or "ticket" in text
    text = text.replace("$TOKEN", "right").replace("$TICKET", "ticket")
    line, _, rest = text.partition("\n")
    method, _, place = line.partition(" ")
    headers = HTTPHeaders.parse(rest)
    seen = {name.lower(): value for name, value in headers.get_all()}
    verdict, _ = gate.judge(Request(method, place, seen))
    demand(secret or verdict in (GateVerdict.REFUSED, GateVerdict.SERVED), "it is let in without a secret")


@cache
def _traces() -> BusTraces:
    traces = BusTraces()
    traces.take(seeds.snapshot())
    return traces


@dataclass
class _OpenPage:
    """A page that takes the messages of RENEWED inputs: to make one costs more than to play a hundred."""

    renewed: int = 0

    def of_next(self) -> _OpenPage:
        """This one, or a new one."""
        if self.renewed % RENEWED == 0:
            self.document, desk = Document(), Desk(_begin, allowed_tasks(asks=True, writes=True))
            self.page = ScopePage(self.document, _traces(), desk, MachineUnits(), None)
            models = self.document.models
            self.names = {str(model.name): model.id for model in models if model.name}
            self.names["file"] = next(model.id for model in models if isinstance(model, FileInput))
        self.renewed += 1
        return self


def _begin(task: ScopeTask, node: int, upload: Any) -> None:
    """Only noted."""
    demand(not task.writes, f"{task.label} begins without the code")
    demand(upload is None or len(upload.data) <= LARGEST_FILE, "a file beyond the limit")


_open_page = _OpenPage()


def _message(path: Path, data: bytes) -> None:
    """Events of a browser, through Bokeh's protocol as its server does it.

    Bokeh's server answers any exception with an error, to that page alone; what is raised by code of canfb is
    a find all the same.
    """
    at = _open_page.of_next()
    text = data.decode("utf-8", errors="replace")
    for name in sorted(at.names, key=len, reverse=True):
        text = text.replace(f"${name}", at.names[name])
    for line in text.split("\n")[:20]:
        try:
            message = Protocol().assemble(HEADER, "{}", f'{{"events": [{line}]}}')
            message.apply_to_document(at.document)
        except Exception as error:
            if _is_ours(error):
                at.renewed = 0
                raise
    at.page.update()


def _is_ours(error: BaseException) -> bool:
    """Whether code of canfb is where it was raised, or called what raised it."""
    trace, last = error.__traceback__, False
    while trace is not None:
        name = trace.tb_frame.f_code.co_filename
        last = last or "/canfb/scope/" in name
        trace = trace.tb_next
    return last


TARGETS = {
    target.name: target
    for target in (
        Target("frames", kept_frames, _frames, (), longest=FRAMES_LONGEST, story=_story_of_frames),
        Target("eds", seeds.eds, _eds, suffix=".eds"),
        Target("dcf", seeds.dcf, _dcf, (ValueError,), ".dcf"),
        Target("concise", seeds.concise, _concise, (ValueError,)),
        Target("config", seeds.configuration, _configuration, suffix=".yaml"),
        Target("plan", seeds.planned, _plan, (CanfbError, ValueError), ".yaml", 1 << 12),
        Target("set", seeds.settings, _settings),
        Target("table", seeds.table_yaml, _table, suffix=".yaml"),
        Target("table-bin", seeds.table_bytes, _table, suffix=".bin"),
        Target("backup", seeds.backup, _backup, suffix=".yaml"),
        Target("csv", seeds.recording_csv, _csv, suffix=".csv"),
        Target("npz", seeds.npz, _npz, suffix=".npz"),
        Target("npy", seeds.npy, _npy, suffix=".npz"),
        Target("candump", seeds.log(".log"), _log, suffix=".log", longest=LOG_LONGEST),
        Target("candump-gz", seeds.log(".log.gz"), _log, suffix=".log.gz", longest=LOG_LONGEST),
        Target("asc", seeds.log(".asc"), _log, suffix=".asc", longest=LOG_LONGEST),
        Target("blf", seeds.log(".blf", compression_level=0), _log, suffix=".blf", longest=LOG_LONGEST),
        Target("trc", seeds.log(".trc"), _log, suffix=".trc", longest=LOG_LONGEST),
        Target("log-csv", seeds.log(".csv"), _log, suffix=".csv", longest=LOG_LONGEST),
        Target("db", seeds.log(".db"), _log, suffix=".db"),
        Target("state", seeds.states, _state, (), sealed=_seal_state),
        Target("notes", seeds.notes, _notes, suffix=".unfinished"),
        Target("request", seeds.requests, _request, (HTTPInputError,), longest=800),
        Target("message", seeds.messages, _message, longest=1 << 13),
    )
}
