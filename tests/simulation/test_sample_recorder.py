"""What was sampled at each SYNC, kept and written, is what is played again."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from canfb.cia301.frame import Frame
from canfb.cli.main import build_parser, main
from canfb.cli.simulate import check_record, chosen, write_record
from canfb.configuration import parse_config
from canfb.errors import CanfbError, ConfigError
from canfb.interface.encoder_interface import EncoderInterface
from canfb.signal.sample import Sample
from canfb.simulation.embedded_bus import EmbeddedBus
from canfb.simulation.set_up import SampleRecorder, source_of
from canfb.sources.protocol import SourceEnded

SYNC, START = Frame(0x080, b""), Frame(0x000, b"\x01\x00")
COUNTS: list[Sample | None] = [Sample(1, -2), Sample(300, 400), None, Sample(-2048, 2047), None, Sample(7, 8)]
RATE_HZ = 500.0


class Listed:
    """Plays a list."""

    def __init__(self, counts: list[Sample | None]) -> None:
        self.counts = list(counts)

    def next(self) -> Sample | None:
        if not self.counts:
            raise SourceEnded
        return self.counts.pop(0)


def recorded(counts: list[Sample | None]) -> SampleRecorder:
    bus, interface = EmbeddedBus(), EncoderInterface(16, Listed(counts))
    recorder = SampleRecorder(interface)
    bus.attach(interface)
    bus.attach(recorder)
    for frame in (SYNC, SYNC, START, *[SYNC] * (len(counts) + 3)):
        bus.send(frame)
    return recorder


def test_each_sync_from_the_first_sample_on_is_an_interval() -> None:
    recorder = recorded(COUNTS)
    assert len(recorder) == len(COUNTS), "not those before the start, nor after the end"
    sine, cosine = recorder.tracks()
    np.testing.assert_array_equal(sine, [1, 300, math.nan, -2048, math.nan, 7])
    np.testing.assert_array_equal(cosine, [-2, 400, math.nan, 2047, math.nan, 8])


def played(path: Path, *options: str) -> list[Sample | None]:
    arguments = ["simulate", "x.yaml", "--samples", str(path), *options]
    source = source_of(
        *chosen(build_parser().parse_args(arguments), parse_config("modules: [{node_id: 32}]"))
    )
    samples = []
    while True:
        try:
            samples.append(source.next())
        except SourceEnded:
            return samples


def test_what_is_written_as_npz_is_played_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "tracks.npz"
    write_record(path, recorded(COUNTS), RATE_HZ)
    assert played(path) == COUNTS
    assert float(np.load(path)["rate_hz"]) == RATE_HZ


def test_what_is_written_as_csv_has_the_time_of_each_sample(tmp_path: Path) -> None:
    path = tmp_path / "tracks.csv"
    write_record(path, recorded(COUNTS), RATE_HZ)
    assert path.read_text().splitlines() == [
        "t_s,sine,cosine", "0,1,-2", "0.002,300,400", "0.006,-2048,2047", "0.01,7,8"
    ]  # fmt: skip
    assert played(path) == [sample for sample in COUNTS if sample is not None]
    # A gap costs the sample before it, as everywhere in such files.
    gaps = ["--time-column", "t_s", "--gap", "0.003", "--gap-samples", "2"]
    assert played(path, *gaps) == [COUNTS[0], None, None, None, None, COUNTS[5]]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("tracks.txt", "must end with .csv or .npz"),
        ("no/folder/x.csv", "there is no folder"),
        ("", "must end"),
    ],
)
def test_a_file_that_cannot_be_is_refused_before_anything_runs(
    tmp_path: Path, name: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "feedback.yaml"
    config.write_text("modules: [{node_id: 32}]\n")
    assert main(["simulate", str(config), "-i", "virtual", "--record", name]) == 2
    assert words in capsys.readouterr().err


def test_a_folder_is_no_file_and_a_file_that_fails_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "x.csv").mkdir()
    with pytest.raises(ConfigError, match="cannot be written"):
        check_record(str(tmp_path / "x.csv"))
    with pytest.raises(CanfbError, match=r"--record .*x\.csv: cannot be written: Is a directory"):
        write_record(tmp_path / "x.csv", recorded(COUNTS), RATE_HZ)


def test_the_command_records_and_ends_by_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config, path = tmp_path / "feedback.yaml", tmp_path / "tracks.npz"
    config.write_text("bus: {interface: virtual, channel: canfb-record}\nmodules: [{node_id: 32}]\n")
    arguments = [str(config), "--rate", "500", "--autostart", "--seconds", "0.1", "--record", str(path)]
    assert main(["simulate", *arguments]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[-2:] == ["50 samples sent", f"written  {path}"]
    assert len(np.load(path)["sine"]) == 50


@pytest.mark.parametrize("seconds", ["0", "-1", "nan", "inf"])
def test_a_duration_that_cannot_be(seconds: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "feedback.yaml"
    config.write_text("modules: [{node_id: 32}]\n")
    assert main(["simulate", str(config), "-i", "virtual", f"--seconds={seconds}"]) == 2
    assert "--seconds" in capsys.readouterr().err
