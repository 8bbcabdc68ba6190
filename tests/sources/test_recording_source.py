"""Recordings: rows, columns, gaps, and what is wrong with a file."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from canfb import CanfbError, Sample
from canfb.sources.protocol import SourceEnded
from canfb.sources.recording_source import RecordingLayout, open_recording
from folding import each
from played import until_end

AB = RecordingLayout(("a", "b"))


def written(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "recording.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_rows_are_played_in_order_and_then_it_ends(tmp_path: Path) -> None:
    source = open_recording(written(tmp_path, "t,a,b\n0,1,-2\n1,3,4\n\n2,5,6\n"), AB)
    assert [source.next() for _ in range(3)] == [Sample(1, -2), Sample(3, 4), Sample(5, 6)]
    for _ in range(2):
        with pytest.raises(SourceEnded):
            source.next()


# What a file may look like, and the pairs and the note that come of it.
@pytest.mark.parametrize(("text", "layout", "pairs", "note"), [
    ("t, a ,b\n0,1,2\n", AB, [(1, 2)], ""),
    ("t, a ,b\n0,1,2\n", RecordingLayout(("1", "2")), [(1, 2)], ""),
    ("1,0,2\n7,8,9\n", RecordingLayout(("1", "0")), [(7, 8)], ""),  # a name goes before a number
    (b'\xef\xbb\xbf"a","b"\r\n"1","2"\r\n', AB, [(1, 2)], ""),
    ("a,b\n1,2\n".encode("utf-16"), AB, [(1, 2)], ""),
    ("a,b\n2048,2047.4\n0,4095\n2048.6,1e3\n", replace(AB, mid_scale=2048.0),
     [(0, -1), (-2048, 2047), (1, -1048)], ""),
    ("a,b\n0.5,-1\n0.25,1\n", replace(AB, scale=2000.0), [(1000, -2000), (500, 2000)], ""),
    ("temp [\xb0C],a,b\n20,1,2\n".encode("cp1252"), AB, [(1, 2)], ""),
    ("t;a;b\n0,5;1000,4;-7,6\n", AB, [(1000, -8)], ", separated by semicolon"),
    ("a\tb, V\n100\t20,0\n", RecordingLayout(("a", "b, V")), [(100, 20)], ", separated by tab"),
    ("sep=;\na;b\n1;2\n", AB, [(1, 2)], ", separated by semicolon"),
    ("sep=|\na|b\n1|2\n", AB, [(1, 2)], ", separated by |"),
    ('a,b\n"100,5",2\n', AB, [(100, 2)], ""),
])  # fmt: skip
def test_files_as_spreadsheets_and_instruments_write_them(
    tmp_path: Path, text: str | bytes, layout: RecordingLayout, pairs: list[tuple[float, float]], note: str
) -> None:
    source = open_recording(written(tmp_path, text), layout)
    assert [sample and sample[:2] for sample in until_end(source)] == pairs
    assert source.note == note


@each(
    "times_s, gap_s, gap_samples, numbers",
    [
        *(((0, 0.1, 0.2, 0.8, 0.9, 2), 0.3, n, [0, 1, *[None] * n, 3, *[None] * n, 5]) for n in (1, 2, 5)),
        ((0, 0.25, 0.75), 0.5, 1, [0, 1, 2]),  # a step as long as the limit
        ((0, 0.25, 0.75), 0.25, 1, [0, None, 2]),
        ((0, 10, 20, 30), 1.0, 2, [0, 1, 2, 3]),  # a slow recording
        ((0, 10, 20, 40), 1.0, 2, [0, 1, None, None, 3]),
    ],
)
def test_at_a_gap_the_last_sample_is_left_out_and_samples_are_lost(
    tmp_path: Path, times_s: list[float], gap_s: float, gap_samples: int, numbers: list[int | None]
) -> None:
    path = written(tmp_path, "t,a,b\n" + "".join(f"{t},{n},0\n" for n, t in enumerate(times_s)))
    layout = replace(AB, time_column="t", gap_s=gap_s, gap_samples=gap_samples)
    assert [sample and sample[0] for sample in until_end(open_recording(path, layout))] == numbers


WRONG: dict[str, tuple[str | bytes, str]] = {
    "empty": ("", ":1: the header line with the names of the columns is missing"),
    "no column": ("x,y\n1,2\n", ":1: there is no column 'a'; there are x, y"),
    "two of a name": ("a,b,a\n1,2,3\n", ":1: there is more than one column 'a'; there are a, b, a"),
    "only the names": ("a,b\n", ": it contains no samples"),
    "a word": ("a,b\n1,2\n1,two\n", ":3: a value in one of the selected columns is not a number"),
    "a short row": ("a,b\n1,2\n1\n", ":3: a value in one of the selected columns is not a number"),
    "not a number": ("a,b\nnan,2\n", ":2: a value in one of the selected columns is not a number"),
    "infinite": ("a,b\n1,inf\n", ":2: a value in one of the selected columns is not a number"),
    "a number after a quoted line end": ('x,a,b\n"one\ntwo",1,2\n3,4,x\n', ":4: a value in one"),
    "too large": ("a,b\n0,32768\n", ":2: 0, 32768 does not fit INTEGER16: --mid-scale 16384"),
    "huge": ("a,b\n1e300,0\n", ":2: 1e+300, 0 does not fit INTEGER16: --mid-scale 5e+299 --scale "),
    "not text": (b"a,b\n\0\0,2\n", ": this is not a text file with columns"),
    "candump": ("(1.0) can0 190#0102\n", ": this is a log of the bus: canfb log replay "),
    "python-can": ("timestamp,arbitration_id,extended\n", ": this is a log of the bus: canfb log replay "),
    "a byte that is no digit": (b"a,b\n\xff\xfe,2\n", ":2: a value in one of the selected columns is not"),
    "a line after that of the separator": ("sep=;\na;b\n1;2\n1;x\n", ":4: a value in one"),
    "volts": ("a,b\n0.1,-0.9\n1,0\n", ": the largest value is 1: these are volts, and ADC counts are"),
    "a field without end": (f"a,b\n1,{'2' * 200_000}\n", ":2: field larger than field limit (131072)"),
    "a line end in a name": ('"x\ny",z\n1,2\n', ":1: there is no column 'a'; there are x y, z"),
    "names without end": (f"{'x,' * 5000}\n1,2\n", ":1: there is no column 'a'; there are x, x"),
}


@pytest.mark.parametrize("case", WRONG)
def test_a_file_that_cannot_be_used_gets_one_line(tmp_path: Path, case: str) -> None:
    text, words = WRONG[case]
    path = written(tmp_path, text)
    with pytest.raises(CanfbError) as caught:
        open_recording(path, AB)
    message = str(caught.value)
    assert message.startswith(f"{path}{words}")
    assert "\n" not in message
    assert len(message) < len(str(path)) + 300


@pytest.mark.parametrize("name", ["c", "2", "-1", "²", ""])
def test_a_column_that_is_not_there_is_refused(tmp_path: Path, name: str) -> None:
    path = written(tmp_path, "a,b\n1,2\n")
    with pytest.raises(CanfbError, match=re.escape(f"{path}:1: there is no column '{name}'; there are a, b")):
        open_recording(path, RecordingLayout(("a", name)))


@each("paced, ticks", [(False, [0, 10_000, 21_000, 30_000]), (True, [0, 50_000, 105_000, 150_000])])
def test_the_times_are_those_of_the_file_or_are_stretched_to_the_rate(
    tmp_path: Path, paced: bool, ticks: list[int]
) -> None:
    """Rows of 1 kHz, one of them 0.1 ms late, played at 200 Hz."""
    text = "t,a,b\n0,1,2\n0.001,3,4\n0.0021,5,6\n0.003,5,6\n"
    layout = RecordingLayout(("a", "b"), time_column="t", time_stamps=True, interval_s=0.005, paced=paced)
    source = open_recording(written(tmp_path, text), layout)
    samples = [source.next() for _ in ticks]
    assert [sample.time_100ns for sample in samples if sample] == ticks


def turning(sine: float = 0.0, cosine: float = 0.0, amplitude: float = 1500.0, unit: float = 1.0) -> str:
    angle = np.linspace(0.1, 40.0, 500)
    pairs = np.column_stack([sine + amplitude * np.sin(angle), cosine + amplitude * np.cos(angle)])
    return "a,b\n" + "".join(f"{s},{c}\n" for s, c in np.rint(pairs / unit) * unit)


UNSIGNED: dict[str, tuple[float, float, float, float, str]] = {
    # middle of sine and cosine, amplitude, unit: what makes signed counts of it
    "12 bits, all": (2047.5, 2047.5, 2047.5, 1.0, "--mid-scale 2048"),
    "12 bits, with offsets": (2110.0, 1990.0, 1500.0, 1.0, "--mid-scale 2048"),
    "10 bits": (512.0, 512.0, 400.0, 1.0, "--mid-scale 512"),
    "16 bits, all": (32767.5, 32767.5, 32767.5, 1.0, "--mid-scale 32768"),
    "24 bits": (8388608.0, 8388608.0, 6e6, 1.0, "--mid-scale 8388608 --scale 0.00390625"),
    "of no converter": (1650.0, 1650.0, 1200.0, 1.0, "--mid-scale 1650"),
    "fractions": (165.0, 165.0, 120.0, 0.001, "--mid-scale 165"),
}


@pytest.mark.parametrize("case", UNSIGNED)
def test_unsigned_readings_are_refused_with_the_options_that_they_need(case: str, tmp_path: Path) -> None:
    *tracks, options = UNSIGNED[case]
    path = written(tmp_path, turning(*tracks))
    with pytest.raises(CanfbError, match=f"no reading is below 0: {options}$"):
        open_recording(path, AB)
    words = options.split()
    named = dict(zip(words[::2], words[1::2], strict=True))
    layout = replace(AB, mid_scale=float(named["--mid-scale"]), scale=float(named.get("--scale", 1.0)))
    counts = np.array(open_recording(path, layout).tracks)
    assert (counts.min(axis=1) < 0).all()
    assert (abs(counts.min(axis=1) + counts.max(axis=1)) < 0.1 * np.ptp(counts, axis=1)).all()


@each("mid_scale, scale, words", [
    (0.0, 100.0, "does not fit INTEGER16: --scale 16"),
    (2.0, 100.0, "does not fit INTEGER16: --mid-scale 0 --scale 16"),
    (40000.0, 1.0, "does not fit INTEGER16: --mid-scale 0"),
    (5000.0, 1.0, "not centred, no reading is above 5000: --mid-scale 0"),
    (-5000.0, 1.0, "not centred, no reading is below -5000: --mid-scale 0"),
])  # fmt: skip
def test_options_that_are_wrong_are_named(mid_scale: float, scale: float, words: str, tmp_path: Path) -> None:
    with pytest.raises(CanfbError, match=f"{re.escape(words)}$"):
        open_recording(written(tmp_path, turning()), replace(AB, mid_scale=mid_scale, scale=scale))


def test_one_unsigned_track_and_a_standing_machine_are_read(tmp_path: Path) -> None:
    """No mid-scale is that of both tracks of the first; without motion nobody knows that of the second."""
    for text in (turning(2048.0, 0.0), turning(700.0, 9.0, 0.0)):
        assert len(open_recording(written(tmp_path, text), AB).tracks[0]) == 500
