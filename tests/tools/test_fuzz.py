"""The fuzzer without its engine: kept, random and changed inputs, and each check does find its fault."""

import os
import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path
from random import Random

import pytest
from hypothesis import given

from canfb import CanfbError, Frame
from canfb.cia301.codes import NmtState, SdoAbort
from canfb.device.sdo.server import SdoServer
from drawing import examples
from folding import each
from tools.fuzz import body, files
from tools.fuzz.__main__ import main
from tools.fuzz.body import Play
from tools.fuzz.bounds import BeyondBoundsError, bounded
from tools.fuzz.files import READERS, NotOneLineError, Reader
from tools.fuzz.inputs import INPUTS, NODE_ID, SERVER, Input
from tools.fuzz.sdo import Broken, SdoWatcher

CORPUS = [
    line.rpartition(": ")
    for line in (Path(__file__).parent / "fuzz_corpus.txt").read_text(encoding="ascii").splitlines()
    if not line.startswith("#")
]
MODULE, INTERFACE = 0, 2


@pytest.mark.parametrize("text", [text for *_, text in CORPUS], ids=[why for why, *_ in CORPUS])
def test_a_kept_input(text: str) -> None:
    body.play(Input.parse(text))


@examples(120)
@given(one=INPUTS["frames"] | INPUTS["sdo"])
def test_any_input(one: Input) -> None:
    assert Input.parse(str(one)) == one
    body.play(one)


@each("begin, segments", [
    ("2120200100000100", (0x00, 0x10)),
    ("2020200100000000", (0x00, 0x10)),
    ("C020200100000000", range(1, 32)),
])  # fmt: skip
def test_memory_is_bounded(begin: str, segments: Sequence[int]) -> None:
    """A client that never ends its download."""
    run = started(MODULE)
    frames = [Frame(SERVER, bytes([command]) + bytes(7)) for command in segments]
    run.receive(Frame(SERVER, bytes.fromhex(begin)))
    tracemalloc.start()
    try:
        for _ in range(24_000 // len(frames)):
            for frame in frames:
                run.device.receive(frame, run.now)
        peak = tracemalloc.get_traced_memory()[1]
        assert peak < 100_000, "65536 for the data, the most that a download may have"
    finally:
        tracemalloc.stop()
    run.check_alive()


def started(choice: int) -> Play:
    run = Play(body.make(choice))
    run.start()
    return run


# The checks, each with a device that does it wrong.


class Rogue:
    """A device that sends one frame more with each frame that it receives."""

    def __init__(self, run: Play, extra: Frame) -> None:
        self._device, self._extra = run.device, extra
        run.device = self  # type: ignore[assignment]

    def __getattr__(self, name: str) -> object:
        return getattr(self._device, name)

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        return [*self._device.receive(frame, now), self._extra]


FIRST_ANSWER = body.FIRST_ANSWER + NODE_ID
READ = Frame(SERVER, bytes.fromhex("4000100000000000"))
ANSWER = bytes.fromhex("4300100096010400")


@each("command, extra, text", [
    (128, Frame(FIRST_ANSWER, ANSWER), "one answer too many"),
    (2, Frame(FIRST_ANSWER, ANSWER), "an SDO answer in STOPPED"),
    (128, Frame(0x1A0, bytes(8)), "in PRE_OPERATIONAL, which has no such service"),
    (2, Frame(0x0A0, bytes(8)), "in STOPPED, which has no such service"),
    (1, Frame(0x555, b""), "in OPERATIONAL, which has no such service"),
    (1, Frame(0x1A0, bytes(9)), "impossible frame"),
    (1, Frame(0x000, bytes(2)), "impossible frame"),
    (1, Frame(0x1A0, b"", True), "a remote frame"),
])  # fmt: skip
def test_a_frame_that_must_not_be_is_found(command: int, extra: Frame, text: str) -> None:
    run = started(MODULE)
    run.receive(Frame(0x000, bytes([command, NODE_ID])))
    Rogue(run, extra)
    with pytest.raises(Broken, match=text):
        run.receive(READ)


def test_a_flood_is_found() -> None:
    run = started(MODULE)
    run.device._outbox.extend([Frame(0x720, b"\x05")] * 161)
    with pytest.raises(Broken, match="frames at once"):
        run.tick()


@each("index, subindex, value", [(0x2001, 1, 0), (0x1A01, 1, 0x20000110), (0x6000, 0, 65536)])
def test_a_spoilt_dictionary_is_found(index: int, subindex: int, value: int) -> None:
    run = started(MODULE)
    run.check_values()
    run.dictionary.entry(index, subindex).value = value
    with pytest.raises((Broken, SdoAbort, ValueError)):
        run.check_values()


def test_a_server_that_is_stuck_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    started(INTERFACE).check_alive()
    monkeypatch.setattr(SdoServer, "handle", lambda server, data, now: None)
    run = started(INTERFACE)
    with pytest.raises(Broken, match="1000h is answered by"):
        run.check_alive()
    assert run.device.state is NmtState.PRE_OPERATIONAL


# request, answer, what is wrong; the answers before are right
@pytest.mark.parametrize(("request_", "answer", "text"), [
    ("4000100000000000", "43001000960104", "an answer of 7 bytes"),
    ("4000100000000000", "8000100001000605", "unknown abort code 05060001h"),
    ("4000100000000000", "4301100096010400", "about another object"),
    ("4000100000000000", "6000100000000000", "is no answer to"),
    ("4000100000000000", "4F00100096010000", "something in unused bytes"),
    ("2F01200301000000", "6001200301000000", "reserved bits set"),
    ("2F01200301000000", "2000000000000000", "is no answer to"),
    ("6000000000000000", "0000000000000000", "segment of nothing"),
    ("6000000000000000", "1000000000000000", "another toggle bit"),
    ("C620200100000000", "A420200180000000", "bad block size"),
    ("C620200100000000", "A120200100000000", "reserved bytes set"),
    ("A02020017F000000", "C220210100000000", "about another object"),
    ("8020200100000000", "8020200100000005", "one answer too many"),
])  # fmt: skip
def test_a_wrong_answer_is_found(request_: str, answer: str, text: str) -> None:
    watcher = SdoWatcher()
    watcher.request(bytes.fromhex(request_))
    with pytest.raises(Broken, match=text):
        watcher.answer(bytes.fromhex(answer))


def test_an_input_is_shown_and_what_it_finds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "crash-1"
    path.write_bytes(bytes(range(200)))
    assert main(["frames", "--play", str(path)]) == 0
    shown = capsys.readouterr().out.removeprefix(f"{path}: ").strip()
    assert body.play(Input.parse(shown)) >= 0
    monkeypatch.setattr(SdoServer, "handle", lambda server, data, now: None)
    assert main(["sdo", "--play", str(path)]) == 1
    assert "1000h is answered by" in capsys.readouterr().err


# The target `files`.


def changed(random: Random, data: bytes, other: bytes) -> bytes:
    """Bytes that are dropped, doubled or set, and a part of another input."""
    for _ in range(random.randint(1, 4)):
        begin, place = (random.randint(0, len(data)) for _ in range(2))
        end = begin + random.randint(0, 16)
        start = random.randint(0, len(other))
        part = random.choice((b"", data[begin:end] * 2, random.randbytes(4), other[start : start + 60]))
        data = data[:place] + part + data[end:] if place < begin else data[:begin] + part + data[end:]
    return data


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numpy, from files with NaN
@pytest.mark.parametrize("number", range(len(READERS)))
def test_inputs_that_were_changed_find_nothing(number: int, tmp_path: Path) -> None:
    random, kind = Random(28), bytes([number])
    seeds = READERS[number].begin()
    assert sum(files.play(kind + seed, tmp_path) for seed in seeds) > 0
    for _ in range(25):  # atheris plays thousands
        data = changed(random, *(random.choice(seeds) for _ in range(2)))
        files.play(kind + data, tmp_path)


def refuse(error: Exception) -> Callable[[Path], None]:
    def read(path: Path) -> None:
        raise error

    return read


@pytest.mark.parametrize(
    ("read", "found"),
    [
        (refuse(CanfbError("a.yaml:1: this is not YAML")), None),
        (refuse(CanfbError("two\nlines")), NotOneLineError),
        (refuse(CanfbError("")), NotOneLineError),
        (refuse(CanfbError("x" * 2000)), NotOneLineError),
        (refuse(CanfbError("MemoryError: 9 GB")), NotOneLineError),
        (refuse(KeyError("other")), KeyError),
    ],
)
def test_what_is_found(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    read: Callable[[Path], None],
    found: type[Exception] | None,
) -> None:
    monkeypatch.setattr(files, "READERS", (Reader("", read, list),))
    if found is None:
        assert files.play(b"\0", tmp_path) is False
    else:
        with pytest.raises(found):
            files.play(b"\0", tmp_path)


def test_an_input_that_takes_too_long_is_found(tmp_path: Path) -> None:
    with pytest.raises(BeyondBoundsError, match="too long"), bounded(tmp_path, seconds=0.05):
        hang()


def hang() -> None:
    while True:
        try:
            sum(range(1000))
        except Exception:
            continue


def test_an_input_that_takes_much_memory_is_found(tmp_path: Path) -> None:
    import resource

    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss << 10
    with pytest.raises(BeyondBoundsError, match="memory"), bounded(tmp_path, memory=16 << 20):
        assert len(bytearray(b"x" * (peak + (32 << 20)))) > peak


@pytest.mark.parametrize(
    "act",
    [
        lambda path: (path / "out").write_bytes(b""),
        lambda path: os.mkdir(path / "folder"),
        lambda path: os.replace(path / "in" / "input", path / "moved"),
        lambda path: os.system("true"),
    ],
    ids=["file", "folder", "move", "program"],
)
def test_an_input_that_writes_elsewhere_is_found(tmp_path: Path, act: Callable[[Path], object]) -> None:
    inside = tmp_path / "in"
    inside.mkdir()
    (inside / "input").write_bytes(b"")
    with pytest.raises(BeyondBoundsError), bounded(inside):
        act(tmp_path)
    with bounded(inside):
        (inside / "own").write_bytes(b"")
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["in", "input", "own"]
