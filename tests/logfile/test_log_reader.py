"""Bus logs as people have them: the frames of python-can where it reads them, and what is odd or damaged."""

import contextlib
import gzip
from base64 import b64encode
from collections.abc import Callable
from pathlib import Path

import can
import pytest
from hypothesis import example, given, strategies as st

from canfb.cia301.frame import Frame
from canfb.logfile import bus_logs
from canfb.logfile.bus_logs import WINDOW_S, BusLogFile, in_order
from canfb.logfile.log_files import LogCounters, LogError
from drawing import examples
from fake_bus import message


def of_kind(kind: str, can_id: int, data: bytes, channel: int) -> can.Message:
    return can.Message(
        arbitration_id=can_id,
        data=b"" if kind in ("remote", "error") else data,
        is_remote_frame=kind == "remote",
        is_extended_id=kind == "extended" or can_id > 0x7FF,
        is_fd=kind == "fd",
        is_error_frame=kind == "error",
        channel=channel,
    )


KINDS = st.sampled_from(["", "", "", "remote", "extended", "fd", "error"])
IDS = st.one_of(st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF))
FRAMES = st.builds(of_kind, KINDS, IDS, st.binary(max_size=8), st.integers(0, 1))


def written(path: Path, messages: list[tuple[int, can.Message]], **options: int) -> Path:
    at = 1_700_000_000_000_000
    with can.Logger(path, **options) as logger:
        for step, message in messages:
            at += step
            message.timestamp = at / 1e6
            logger.on_message_received(message)
    return path


@pytest.mark.parametrize("suffix", [".log", ".blf", ".asc", ".trc", ".csv", ".log.gz", ".asc.gz"])
@examples(10)
@given(messages=st.lists(st.tuples(st.integers(0, 2_000_000), FRAMES), max_size=40))
def test_the_frames_are_those_of_python_can(
    tmp_path_factory: pytest.TempPathFactory, suffix: str, messages: list[tuple[int, can.Message]]
) -> None:
    if suffix == ".csv":  # it has no CAN FD
        messages = [(step, one) for step, one in messages if not one.is_fd]
    path = written(tmp_path_factory.mktemp("logs") / f"bus{suffix}", messages)
    everything = list(can.LogReader(path))
    classic = [one for one in everything if not (one.is_extended_id or one.is_fd or one.is_error_frame)]
    for channel in (None, "can1" if suffix.startswith(".log") else "1"):
        log = BusLogFile(path, channel)
        taken = [one for one in classic if channel in (None, str(one.channel))]
        assert list(log) == [
            Frame(one.arbitration_id, bytes(one.data), one.is_remote_frame, one.timestamp) for one in taken
        ]
        assert log.trouble is None
        counters = log.counters
        assert counters.frames == len(everything)
        assert counters.damaged_lines == counters.empty_lines == counters.late == 0
        left_out = [(name, can_id) for name, ids in counters.left_out.items() for can_id in ids.elements()]
        others = [(str(one.channel), one.arbitration_id) for one in classic if one not in taken]
        assert sorted(left_out) == sorted(others)
    assert len(list(BusLogFile(path, others=True))) == len(everything)


def test_a_db_does_not_mark_can_fd_but_its_length_does(tmp_path: Path) -> None:
    path = written(tmp_path / "bus.db", [(1, of_kind("fd", 0x190, bytes(length), 0)) for length in (4, 12)])
    log = BusLogFile(path)
    assert [len(frame.data) for frame in log] == [4]
    assert log.counters.not_canopen == 1


def frames_of(number: int) -> list[tuple[float, int, bytes]]:
    return [(n * 1e-3, 0x80 + n % 3, bytes([n % 256, 0xEC])) for n in range(number)]


def line_of(suffix: str, at: float, can_id: int, data: bytes) -> str:
    number, words, base64 = len(data), data.hex(" ").upper(), b64encode(data).decode()
    return {
        ".log": f"({1.7e9 + at:.6f}) can0 {can_id:03X}#{data.hex().upper()}\n",
        ".asc": f"   {at:.6f} 1  {can_id:03X}             Rx   d {number} {words}\n",
        ".trc": f"{1:7d} {at * 1e3:13.3f} DT  1     {can_id:04X} Rx -  {number}    {words}\n",
        ".csv": f"{1.7e9 + at!r},{can_id:#x},0,0,0,{number},{base64}\n",
    }[suffix]


ASC = "date Tue Nov 14 22:13:20.000 2023\nbase hex  timestamps absolute\n"
TRC = ";$FILEVERSION=2.1\n;$STARTTIME=45244.9\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n"
CSV = "timestamp,arbitration_id,extended,remote,error,dlc,data\n"
HEADS = {".log": "", ".asc": ASC, ".trc": TRC, ".csv": CSV}
Lines = list[str]
Costs = tuple[int, int, int]


def inserted(text: str) -> Callable[[Lines], Lines]:
    return lambda lines: [*lines[:5], text, *lines[5:]]


def two_cut_off(length: int) -> Callable[[Lines], Lines]:
    return lambda lines: [*lines[:5], lines[5][:-4] + "\n", lines[6][:length] + "\n", *lines[7:]]


# suffix, header, what is done to the lines, frames that are missing, damaged and empty lines
@pytest.mark.parametrize(("suffix", "head", "change", "costs"), [
    (".log", "# machine on\n", inserted("\n"), (0, 0, 2)),
    (".log", "", lambda lines: [*lines[:5], lines[5][:24] + "\n", *lines[6:]], (1, 1, 0)),
    (".log", "", lambda lines: [*lines[:-1], lines[-1][:-3]], (1, 1, 0)),
    (".log", "", lambda lines: [*lines[:-1], lines[-1].rstrip("\n")], (0, 0, 0)),
    (".log", "", inserted("garbage \0\n(x) can0 080#\n(1.0) can0 080#1\n(1.0) can0 19\n"), (0, 4, 0)),
    (".log", "", inserted("(2.0) can0 190#001122334455667788\n"), (0, 1, 0)),
    (".asc", ASC.replace("Nov", "M\xe4r"), inserted("// K\xfchlung 20 \xb0C\n\n"), (0, 0, 0)),
    (".asc", "\ufeff// Vector\n\nbase hex\n", lambda lines: lines, (0, 0, 0)),
    (".asc", ASC, inserted("   0.000000 CANFD Start of measurement\n0.1 1 Statistic: D 0 R 0\n"), (0, 0, 0)),
    (".asc", ASC, two_cut_off(20), (2, 2, 0)),
    (".asc", ASC, lambda lines: [one.replace(".", ",", 1) for one in lines], (0, 0, 0)),
    (".asc", ASC, inserted("\0\0\n 0.\1 1  080  Rx  d 0\n 0.1 1 J1939TP FEE3p 6 0 0 Rx d 1 00\n"), (0, 2, 0)),
    (".trc", TRC, inserted("\0" * 90 + "\n  garbage DT  1  0080 Rx -  0\n\n"), (0, 2, 0)),
    (".csv", CSV, inserted("K\xfchlung\n1,2\n\n"), (0, 2, 0)),
    (".asc", ASC, lambda lines: [*lines[:-1], lines[-1][:-2]], (1, 1, 0)),
    (".asc", ASC, lambda lines: [*lines[:-1], lines[-1][:33]], (1, 1, 0)),
    (".asc", ASC, inserted("   0.000100 1  Speed   Rx   d 1 00\n"), (0, 1, 0)),
    (".trc", TRC + "; Pr\xfcfstand\n\n", inserted("; \xb5\n"), (0, 0, 0)),
    (".trc", TRC.replace("45244.9", "45244,9"), inserted("      7      5.000 ST  1 Rx 00 00\n"), (0, 0, 0)),
    (".trc", TRC, two_cut_off(24), (2, 2, 0)),
    (".trc", TRC, lambda lines: [one.replace(".", ",", 1) for one in lines], (0, 0, 0)),
])  # fmt: skip
@pytest.mark.parametrize("form", ["cp1252", "cp1252.gz", "utf-16", "utf-16.gz"])
def test_odd_lines_cost_themselves(
    tmp_path: Path, suffix: str, head: str, change: Callable[[Lines], Lines], costs: Costs, form: str
) -> None:
    encoding, dot, zipped = form.partition(".")
    text = head + "".join(change([line_of(suffix, *one) for one in frames_of(20)]))
    content = text.encode("utf-8" if "\ufeff" in head else encoding)
    path = tmp_path / f"a{suffix}{dot}{zipped}"
    path.write_bytes(gzip.compress(content) if zipped else content)
    log = BusLogFile(path)
    frames, counters = list(log), log.counters
    assert log.trouble is None
    assert (20 - len(frames), counters.damaged_lines, counters.empty_lines) == costs
    expected = {(can_id, data) for _, can_id, data in frames_of(20)}
    assert {(frame.can_id, frame.data) for frame in frames} <= expected
    assert (counters.first_damaged_line > 0) == (counters.damaged_lines > 0)


TRC_1 = {
    "": ["0190  2  01 02", "0008  4  ERROR 00 19 08 08", "FFFFFFFF  4  00 00 00 04 -- -- -- --  BUSLIGHT"],
    "1.1": ["Rx  0190  2  01 02", "Warng  FFFFFFFF  4  00 00 00 04", "Error  0008  4  00 19 08 08"],
    "1.2": ["1  Rx  0190  2  01 02", "1  Warng  FFFFFFFF  4  00 00 00 04  BUSLIGHT"],
}


@pytest.mark.parametrize(("version", "lines"), TRC_1.items())
def test_trc_1_with_lines_that_are_no_frames(tmp_path: Path, version: str, lines: list[str]) -> None:
    text = f";$FILEVERSION={version}\n;$STARTTIME=37704.5\n" if version else ";\n"
    (tmp_path / "a.trc").write_text(text + "".join(f"{n})  {n}  {line}\n" for n, line in enumerate(lines, 1)))
    log = BusLogFile(tmp_path / "a.trc")
    assert [(frame.can_id, frame.data) for frame in log] == [(0x190, b"\1\2")]
    assert (log.trouble, log.counters.damaged_lines) == (None, 0)


def test_a_classic_frame_has_eight_bytes(tmp_path: Path) -> None:
    (tmp_path / "a.asc").write_text("base hex\n0.1 1  190  Rx   d f 01 02 03 04 05 06 07 08\n")
    log = BusLogFile(tmp_path / "a.asc")
    assert (len(list(log)), log.counters.damaged_lines) == (1, 0)


def test_asc_with_the_time_since_the_event_before_and_decimal_numbers(tmp_path: Path) -> None:
    path = tmp_path / "a.asc"
    lines = "".join(f"   0.001000 1  {0x190}  Rx   d 2 9 255\n" for _ in range(5))
    path.write_text(f"base dec  timestamps relative\n0.5 Start of measurement\n{lines}")
    frames = list(BusLogFile(path))
    assert {(frame.can_id, frame.data) for frame in frames} == {(0x190, b"\x09\xff")}
    assert [frame.timestamp for frame in frames] == pytest.approx([0.501 + n * 1e-3 for n in range(5)])


@pytest.mark.parametrize("suffix", [".blf", ".log.gz", ".asc.gz", ".trc.gz"])
def test_of_a_file_that_was_cut_off_the_begin_is_used(tmp_path: Path, suffix: str) -> None:
    frames = [message(n * 7919 % 0x7FF, n.to_bytes(4), channel=0) for n in range(9000)]
    path = written(tmp_path / f"whole{suffix}", [(1000, one) for one in frames])
    whole, content = list(BusLogFile(path)), path.read_bytes()
    assert len(whole) == len(frames)
    counts = []
    for part in (0.3, 0.6, 0.9, 1.0 - 9 / len(content)):
        cut = tmp_path / f"cut{suffix}"
        cut.write_bytes(content[: int(len(content) * part)])
        log = BusLogFile(cut)
        counts.append(len(found := list(log)))
        assert found == whole[: counts[-1]]
        assert log.trouble is not None
        assert "damaged or incomplete" in log.trouble
        with pytest.raises(LogError, match="damaged or incomplete"):
            log.check_end(lambda words: None)
    assert 0 < counts[0] < counts[1] < counts[2] <= counts[3]


def test_a_blf_that_was_never_closed_says_so(tmp_path: Path) -> None:
    writer = can.BLFWriter(str(tmp_path / "a.blf"))
    for n in range(9000):
        writer.on_message_received(can.Message(1.7e9 + n * 1e-3, n % 0x7FF, data=bytes(8)))
    writer.file.flush()
    (tmp_path / "b.blf").write_bytes((tmp_path / "a.blf").read_bytes())
    writer.stop()
    log = BusLogFile(tmp_path / "b.blf", others=True)
    assert 0 < len(list(log)) < 9000
    assert "never closed" in (log.trouble or "")


@examples(40)
@given(st.integers(0, 9), st.sampled_from((0, 8)), st.integers(0, 48) | st.integers(600, 1 << 31))
@example(number=6, field=8, value=0)  # it has no length
@example(number=6, field=8, value=0xFFFF)  # it does not end
@example(number=11, field=8, value=-42)  # its head is cut off
def test_what_a_damaged_blf_does_not_give_is_said(
    tmp_path_factory: pytest.TempPathFactory, number: int, field: int, value: int
) -> None:
    frames = [(1000, message(n, b"", channel=0)) for n in range(9)]
    path = written(tmp_path_factory.mktemp("logs") / "a.blf", frames, compression_level=0)
    whole, data = list(BusLogFile(path)), path.read_bytes()
    at = [n for n in range(len(data)) if data.startswith(b"LOBJ", n)][number % 10] + field
    path.write_bytes(data[:at] + value.to_bytes(4, "little") + data[at + 4 :] if value >= 0 else data[:value])
    log = BusLogFile(path)
    with contextlib.suppress(LogError):
        assert list(log) == whole or log.trouble is not None


def test_a_line_that_does_not_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus_logs, "BLOCK_BYTES", 1000)
    path = tmp_path / "a.log.gz"
    path.write_bytes(gzip.compress(b"(1.0) can0 080#\n" + bytes(100_000) + b"\n(2.0) can0 081#\n"))
    log = BusLogFile(path)
    with gzip.open(path) as file:
        assert max(len(block) for _, block in bus_logs.blocks_of(file, log.counters)) <= 2002
    assert [frame.can_id for frame in log] == [0x80, 0x81]
    assert log.counters.damaged_lines > 50


@given(
    data=st.binary(max_size=400),
    suffix=st.sampled_from([".log", ".blf", ".asc", ".trc", ".log.gz", ".csv", ".db"]),
    begin=st.sampled_from(["", *(head + line_of(suffix, 0.1, 1, b"\1") for suffix, head in HEADS.items())]),
)
def test_any_bytes_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, data: bytes, suffix: str, begin: str
) -> None:
    path = tmp_path_factory.mktemp("logs") / f"bus{suffix}"
    path.write_bytes(begin.encode() + data)
    frames, refused = [], "-"
    try:
        frames += list(BusLogFile(path))
    except LogError as error:
        refused = str(error)
    assert len(refused.splitlines()) == 1
    assert len(refused) < 600
    assert all(len(frame.data) <= 8 or suffix == ".csv" for frame in frames)


def cyclic(number: int, begin_s: float = 100.0) -> list[Frame]:
    """SYNC, sample and position each millisecond."""
    places = ((0.0, 0x80), (2e-4, 0x190), (2.1e-4, 0x1A0))
    return [
        Frame(can_id, b"", False, begin_s + n * 1e-3 + at) for n in range(number) for at, can_id in places
    ]


def put_in_order(frames: list[Frame], size: int) -> list[Frame]:
    batches = [frames[n : n + size] for n in range(0, len(frames), size)]
    return [frame for batch in in_order(batches, LogCounters()) for frame in batch]


@examples(40)
@given(
    off_s=st.one_of(st.floats(-0.9 * WINDOW_S, -1e-4), st.floats(1.3 * WINDOW_S, 1e9)),
    every=st.integers(1, 200),
    burst=st.integers(1, 5),
    size=st.sampled_from([100, 333, 4000]),
)
def test_stamps_late_or_far_ahead_move_no_others(off_s: float, every: int, burst: int, size: int) -> None:
    every = every if off_s < 0.0 else max(every, 3 * burst)  # those far ahead are fewer than others
    written_down: list[Frame] = []
    for n, frame in enumerate(own := cyclic(200)):
        written_down.append(frame)
        if n % every == every - 1 and n < 580:  # more than as many follow the last ones
            at = (frame.timestamp or 0.0) + off_s
            written_down += [Frame(0x705, b"", False, at + k * 1e-5) for k in range(burst)]
    found = put_in_order(written_down, size)
    assert [frame for frame in found if frame.can_id != 0x705] == own
    stamps = [[one.timestamp or 0.0 for one in frames] for frames in (found, written_down)]
    assert stamps[0] == sorted(stamps[off_s < 0.0])


@given(st.integers(1, 500), st.integers(1, 90), st.sampled_from([100, 333, 4000]))
def test_two_frames_that_changed_places_get_them_back(first: int, apart: int, size: int) -> None:
    frames = cyclic(200)
    frames[first], frames[first + apart] = frames[first + apart], frames[first]
    assert put_in_order(frames, size) == cyclic(200)


@examples(25)
@given(back_s=st.one_of(st.floats(0.003, 0.4), st.floats(2.0, 1e6)), size=st.sampled_from([100, 333, 4000]))
def test_a_clock_that_was_set_back_keeps_the_order(back_s: float, size: int) -> None:
    both = [*cyclic(500), *cyclic(size // 8, 100.5 - back_s)]  # the log may end soon
    assert put_in_order(both, size) == both


def test_stamps_that_are_no_numbers_stay_where_they_are() -> None:
    for bad in (None, float("nan"), float("inf")):
        frames = [*cyclic(5), Frame(1, b"", False, bad), *cyclic(5, 101.0)]
        assert [frame.can_id for frame in put_in_order(frames, 3)] == [frame.can_id for frame in frames]
