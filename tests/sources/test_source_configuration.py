"""`source:` of a module: what is right loads and opens, what is wrong gets one line; a kind is one file."""

import contextlib
import dataclasses
import math
import re
import statistics
import sys
import types
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, strategies as st

import canfb.sources
from canfb import BusError, ConfigError, FeedbackModule, Frame, Sample
from canfb.cli.config_file import EXAMPLE
from canfb.cli.printing import printed_log
from canfb.configuration import parse_config
from canfb.hosting.hosting import make_module, open_source
from canfb.master.samples import TrackSamples, write_npz
from canfb.signal.supervision import VALID
from canfb.simulation.encoder import Encoder, Motion, MotionSource, Ramp, Ripple, ShaftEncoder
from canfb.sources.iio_source import ChannelScaling, IioCapture, IioSourceConfig
from canfb.sources.motion_source import MotionSourceConfig
from canfb.sources.protocol import Source, SourceConfig, source_kinds
from canfb.sources.recording_source import RecordingSourceConfig
from commands import Command, yaml_file
from documentation import blocks, page
from folding import each
from played import until_end
from processes import python
from test_configuration import loaded_or_refused


def source_of(text: str, module: str = "") -> SourceConfig | None:
    config = parse_config(f"modules:\n  - node_id: 32\n    source: {text}\n{module}")
    return config.modules[0].source


@each("text", [
    "{kind: motion}",
    "{kind: motion, rate_hz: 500}",
    "{kind: recording, file: tracks.csv}",
    "{kind: recording, file: a.csv, columns: [1, b], mid_scale: 2048, time_column: t, gap_s: 1, "
    "gap_samples: 3}",
    "{kind: recording, file: a.csv, time_column: 0, time_stamps: true}",
    "{kind: iio, device: ads7950}",
    "{kind: iio, device: x, uri: 'ip:10.0.0.1', sine: voltage2, cosine: voltage3, mid_scale: 2048, "
    "trigger: t0, rate_hz: 4000, time_stamps: false, buffer_scans: 32, wait_us: 500}",
])  # fmt: skip
def test_what_is_right_loads(text: str) -> None:
    keys = yaml.safe_load(text)
    assert source_of(text) == source_kinds()[keys["kind"]](**keys)


def test_only_bits_that_are_stated_are_held_against_the_converter() -> None:
    unstated = source_of("{kind: iio, device: x}")
    stated = source_of("{kind: iio, device: x}", "    adc_bits: 12\n")
    assert isinstance(unstated, IioSourceConfig)
    assert isinstance(stated, IioSourceConfig)
    assert (unstated.adc_bits, stated.adc_bits) == (None, 12)


WRONG = {
    "iio": "'source' must be a mapping with a kind",
    "[motion]": "'source' must be a mapping with a kind",
    "{device: x}": "'kind' is missing in source; known: iio, motion, recording",
    "{kind: adc}": "unknown kind 'adc' of source; known: iio, motion, recording",
    "{kind: [iio]}": "unknown kind None of source",
    "{kind: iio, kind: iio}": "key 'kind' is already in line",
    "{kind: iio}": "'device' is missing in source",
    "{kind: recording}": "'file' is missing in source",
    "{kind: iio, device: x, adc_bits: 12}": "unknown key 'adc_bits' in source",
    "{kind: iio, devices: x}": "unknown key 'devices' in source; did you mean 'device'?",
    "{kind: iio, device: ''}": "source: device must be text, not ''",
    "{kind: iio, device: 7}": "source: device must be text, not 7",
    "{kind: iio, device: x, sine: voltage1}": "source: cosine must differ from sine",
    "{kind: iio, device: x, uri: 'ip:ä'}": "source: uri must be such as",
    "{kind: iio, device: x, trigger: ''}": "source: trigger must be text",
    "{kind: iio, device: x, mid_scale: middle}": "source: mid_scale must be a finite number, not 'middle'",
    "{kind: iio, device: x, mid_scale: .nan}": "source: mid_scale must be a finite number",
    "{kind: iio, device: x, rate_hz: 0}": "source: rate_hz must be a whole number 1..10000000, not 0",
    "{kind: iio, device: x, time_stamps: 1}": "source: time_stamps must be true or false, not 1",
    "{kind: iio, device: x, buffer_scans: 1}": "source: buffer_scans must be a whole number 2..65536",
    "{kind: iio, device: x, wait_us: 5}": "source: wait_us must be a whole number 10..1000000",
    "{kind: iio, device: x, scans_per_sync: 4, time_stamps: false}": "source: scans_per_sync needs",
    "{kind: iio, device: x, scans_per_sync: 1}": "source: scans_per_sync must be a whole number 2..256",
    "{kind: motion, rate_hz: 0}": "source: rate_hz must be a number 0.1..100000, not 0",
    "{kind: motion, file: x}": "unknown key 'file' in source; known: kind, rate_hz",
    "{kind: recording, file: x, columns: a}": "source: columns must be two, [sine, cosine], not 'a'",
    "{kind: recording, file: x, columns: [a, b, c]}": "source: columns must be two",
    "{kind: recording, file: x, columns: [a, a]}": "source: columns must be two, [sine, cosine], not ['a', ",
    "{kind: recording, file: x, columns: [a, [b]]}": "a part of 'columns' in source must be a single value",
    "{kind: recording, file: x, columns: [a, null]}": "source: columns must be a name or a number",
    "{kind: recording, file: x, gap_s: 0}": "source: gap_s must be a number 1e-09..1e+12, not 0",
    "{kind: recording, file: x, gap_samples: 0}": "source: gap_samples must be a whole number 1..1000000",
    "{kind: recording, file: x, time_stamps: true}": "source: time_stamps need a time_column",
    "{kind: recording, file: x.npz, scale: 3, gap_s: 1}": "source: scale, gap_s: only for CSV, not for x.npz",
}


@each("text", WRONG)
def test_what_is_wrong_gets_one_line(text: str) -> None:
    with pytest.raises(ConfigError, match=rf"^configuration:3: {re.escape(WRONG[text])}"):
        source_of(text)


def test_wrong_bits_are_the_fault_of_the_key_of_the_module() -> None:
    with pytest.raises(ConfigError, match=r"^configuration:4: modules\[0\]: adc_bits must be"):
        source_of("{kind: iio, device: x}", "    adc_bits: 24\n")


def test_the_encoder_interface_is_nobodys_business_with_a_source() -> None:
    both = "modules:\n  - {node_id: 16, source: {kind: motion}}\n  - {node_id: 17, source: {kind: motion}}\n"
    assert [module.node_id for module in parse_config(both).modules] == [16, 17]
    with pytest.raises(ConfigError, match="encoder_interface 16"):
        parse_config("modules:\n  - {node_id: 16, source: {kind: motion}}\n  - {node_id: 17}\n")


plain = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8))
KINDS = (RecordingSourceConfig, MotionSourceConfig, IioSourceConfig)
KEYS = st.sampled_from([field.name for kind in KINDS for field in dataclasses.fields(kind)])


@given(
    st.sampled_from(["iio", "motion", "recording"]),
    st.dictionaries(KEYS, plain | st.lists(plain), max_size=4),
)
def test_any_value_of_a_key_loads_or_is_refused(kind: str, keys: dict[str, object]) -> None:
    source = {"kind": kind} | ({"device": "x"} if kind == "iio" else {}) | keys
    text = yaml.safe_dump({"modules": [{"node_id": 3, "source": source}]}, allow_unicode=True)
    config = loaded_or_refused(text)
    assert config is None or config.modules[0].source is not None


CONFIGURATIONS = blocks(page("local-adc").partition("\n## An encoder interface")[0], "yaml")


def test_it_shows_every_kind() -> None:
    kinds = {
        module.source.kind
        for text in CONFIGURATIONS
        for module in parse_config(text).modules
        if module.source is not None
    }
    assert kinds == set(source_kinds())


def test_the_example_of_the_command_shows_a_source() -> None:
    (source,) = [line.split("#")[1].strip() for line in EXAMPLE.splitlines() if "# source:" in line]
    config = parse_config(f"modules:\n  - node_id: 32\n    {source}\n")
    assert isinstance(config.modules[0].source, IioSourceConfig)


def opened(source: str, more: str = "") -> Source:
    config = parse_config(f"modules: [{{node_id: 32, source: {source}}}]\n{more}")
    (module,) = config.modules
    assert module.source is not None
    with contextlib.ExitStack() as resources:
        return open_source(module, module.source, config, resources)[1]


def test_the_motion_is_that_of_the_simulation() -> None:
    simulation = (
        "simulation: {encoder: {amplitude: 0.5, noise_lsb: 0}, motion: {standstill_s: 0, ramp_s: 0, rpm: 6}}"
    )
    samples = until_end(opened("{kind: motion, rate_hz: 500}", simulation))
    # 6 rpm of 2500 cycles at 500 Hz: half a cycle for each sample.
    assert samples[:3] == [Sample(0, 1024), Sample(0, -1024), Sample(0, 1024)]


@pytest.fixture
def tracks(tmp_path: Path) -> Path:
    path = tmp_path / "tracks.csv"
    path.write_text("t,a,b\n0,2048,2049\n0.001,2050,2051\n5,2052,2053\n6.5e2,2054,2055\n")
    return path


def test_a_recording_with_gaps_and_times(tracks: Path) -> None:
    layout = "columns: [a, b], mid_scale: 2048, time_column: t, gap_samples: 2"
    source = f"{{kind: recording, file: {tracks}, {layout}}}"
    assert until_end(opened(source)) == [Sample(0, 1), None, None, None, None, Sample(6, 7)]
    timed = source.replace("}", ", gap_s: 1000, time_stamps: true}")
    times = [sample and sample.time_100ns for sample in until_end(opened(timed))]
    assert times == [0, 10_000, 50_000_000, 6_500_000_000 % 2**32]


def test_a_recording_of_the_tools(tmp_path: Path) -> None:
    path = tmp_path / "samples.npz"
    write_npz(path, TrackSamples.of([1.0, np.nan, 3.0], [4.0, np.nan, -6.0], 1000.0, "test"))
    assert until_end(opened(f"{{kind: recording, file: {path}}}")) == [Sample(1, 4), None, Sample(3, -6)]


def test_a_module_of_the_command_runs_on_its_source(capsys: pytest.CaptureFixture[str], tracks: Path) -> None:
    text = f"{{kind: recording, file: {tracks}, columns: [a, b], mid_scale: 1000}}"
    config = parse_config(f"modules: [{{node_id: 32, autostart: true, source: {text}}}]")
    with contextlib.ExitStack() as resources, printed_log():
        module = make_module(config.modules[0], resources, {}, config)
        module.start(0.0)
        for n in range(4):
            module.receive(Frame(0x80, b""), n * 1e-3)
            assert module.feedback is not None
            assert module.feedback.status & VALID
        for n in range(4, 10):
            module.receive(Frame(0x80, b""), n * 1e-3)
    assert capsys.readouterr().err == "canfb: node 32: the source has ended: no more samples\n"


CONFIG = IioSourceConfig(device="ads7950")


def test_without_the_binding(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "iio", None)
    with pytest.raises(BusError, match=re.escape("pip install 'canfb[iio]'")):
        IioCapture(CONFIG)


@pytest.mark.parametrize("failure", ["AttributeError('undefined symbol: iio_x')", "OSError('libiio.so.0')"])
def test_without_the_library(failure: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module that comes before the one that is installed; iio is not loaded yet."""
    monkeypatch.delitem(sys.modules, "iio", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "iio.py").write_text(f"raise {failure}\n")
    with pytest.raises(BusError, match="apt-get install libiio0"):
        IioCapture(CONFIG)


def test_a_library_of_another_generation_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    newer = types.ModuleType("iio")
    newer.__dict__["version"] = (1, 0, "v1.0")
    monkeypatch.setitem(sys.modules, "iio", newer)
    with pytest.raises(BusError, match=re.escape("needs libiio 0.x and pylibiio below 1, not v1.0")):
        IioCapture(CONFIG)


def test_nothing_loads_the_binding_before_it_is_used() -> None:
    assert python("-c", "import sys, canfb.cli.run; print('iio' in sys.modules)").stdout == "False\n"


@pytest.mark.parametrize("bits", [4, 8, 12, 16, 18, 24, 32])
@pytest.mark.parametrize("signed", [True, False])
def test_both_ends_of_the_range_and_its_middle(bits: int, signed: bool) -> None:
    scaling = ChannelScaling(bits, signed, None)
    full_scale = 1 << min(bits, 16) - 1
    lowest = -(1 << bits - 1) if signed else 0
    readings = lowest, lowest + (1 << bits - 1), lowest + (1 << bits) - 1
    assert [scaling.counts(reading) for reading in readings] == [-full_scale, 0, full_scale - 1]


@pytest.mark.parametrize("mid_scale", [-1e9, 0.0, 100.5, 4095.0, 1e9])
def test_wherever_mid_scale_is_counts_stay_within_their_bits(mid_scale: float) -> None:
    scaling = ChannelScaling(12, False, mid_scale)
    counts = [scaling.counts(reading) for reading in range(4096)]
    assert counts == sorted(counts)
    assert (counts[0], counts[-1]) == (-2048, 2047)


FILE = """
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from canfb.checks import number
from canfb.signal.sample import Sample
from canfb.sources.protocol import Source, SourceConfig, SourceEnded, Surroundings


@dataclass(frozen=True, kw_only=True)
class SteadySourceConfig(SourceConfig):
    kind: str = "steady"
    steps: Sequence[float] = field(metadata={"list": True})

    def __post_init__(self):
        super().__post_init__()
        for step in self.steps:
            number("steps", step)

    def open(self, surroundings: Surroundings) -> Source:
        source = SteadySource(self.steps)
        surroundings.resources.callback(source.close)
        return source


class SteadySource:
    adc_bits = 14

    def __init__(self, steps):
        self._steps = iter(steps)
        self._position = 0.0
        self.closed = False

    def close(self):
        self.closed = True

    def next(self):
        try:
            self._position += next(self._steps)
        except StopIteration:
            raise SourceEnded from None
        angle = 2 * math.pi * self._position
        return Sample(6000.0 * math.sin(angle), 6000.0 * math.cos(angle))
"""


@pytest.fixture
def one_more_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The file, as if it were in the folder."""
    (tmp_path / "steady_source.py").write_text(FILE)
    monkeypatch.setattr(canfb.sources, "__path__", [*canfb.sources.__path__, str(tmp_path)])
    yield
    sys.modules.pop("canfb.sources.steady_source", None)


def configuration(source: str) -> str:
    return f"modules:\n  - node_id: 32\n    autostart: true\n    source:\n      kind: steady\n{source}"


@pytest.mark.usefixtures("one_more_file")
def test_a_new_kind_is_one_file_that_the_registry_finds_and_a_module_runs_on() -> None:
    assert list(source_kinds()) == ["iio", "motion", "recording", "steady"]
    config = parse_config(configuration("      steps: [0, 0.125, 0.25, 0.375, 0.375]\n"))
    with contextlib.ExitStack() as resources:
        (module_config,) = config.modules
        assert module_config.source is not None
        module_config, source = open_source(module_config, module_config.source, config, resources)
        assert module_config.adc_bits == 14, "those of its converter"
        module = FeedbackModule(module_config, source=source)
        told: list[str] = []
        module.on_source = told.append
        module.start(0.0)
        positions = []
        for n in range(7):
            module.receive(Frame(0x80, b""), n * 1e-3)
            if module.feedback is not None and module.feedback.status & VALID:
                positions.append(module.feedback.cycles + module.feedback.phase)
        assert not source.closed  # type: ignore[attr-defined]
    assert positions == pytest.approx([0.0, 0.125, 0.375, 0.75, 1.125], abs=2e-3)
    assert told == ["the source has ended: no more samples"]
    assert source.closed  # type: ignore[attr-defined]


@pytest.mark.usefixtures("one_more_file")
def test_its_values_are_asked_by_the_check(tmp_path: Path, command: Command) -> None:
    path = yaml_file(tmp_path, configuration("      steps: [1, two]\n"))
    said = command("config check", path, code=2).err
    assert said == f"canfb: {path}:6: source: steps must be a finite number, not 'two'\n"


MOTION = Motion((Ramp(0.1, 0.0), Ramp(1.0, -700.0), Ramp(2.0, 900.0)), (Ripple(20.0, 3.0),))


def source(motion: Motion = MOTION, aperture_jitter_s: float = 0.0, noise_lsb: float = 0.0) -> MotionSource:
    return MotionSource(ShaftEncoder(Encoder(noise_lsb=noise_lsb), 2500, 1, aperture_jitter_s), motion, 1e-3)


@given(st.lists(st.floats(0, 1.0), min_size=1, max_size=30), st.floats(0, 1e5))
def test_the_position_is_a_function_of_true_time_whatever_is_sampled(
    steps: list[float], start: float
) -> None:
    one, now = source(), start
    one.sample_at(now)
    for step in steps:
        now += step
        one.sample_at(now)
        assert one.position_cycles == pytest.approx(2500 * MOTION.revolutions(now - start), abs=1e-5)


def test_the_coarse_track_has_one_cycle_per_revolution() -> None:
    one = source(Motion((), start_rpm=6.0))
    for tenth in range(25):
        sample = one.sample_at(float(tenth))
        angle = 2 * math.pi * tenth / 10
        assert sample.coarse_sine == pytest.approx(1500 * math.sin(angle), abs=1)
        assert sample.coarse_cosine == pytest.approx(1500 * math.cos(angle), abs=1)


@given(st.floats(-3000, 3000).filter(lambda rpm: abs(rpm) > 10), st.floats(1e-4, 0.05))
def test_there_is_a_zero_pulse_in_each_interval_past_a_revolution(rpm: float, interval_s: float) -> None:
    one = source(Motion((), start_rpm=rpm))
    before = None
    for n in range(100):
        at = n * interval_s
        sample, revolutions = one.sample_at(at), rpm / 60 * at
        if before is not None and math.floor(before) != math.floor(revolutions):
            assert sample.zero_pulse is not None
            passed = before + sample.zero_pulse * (revolutions - before)
            assert abs(passed - round(passed)) < 1e-6, "there the position is a whole number of revolutions"
            assert abs(revolutions - round(passed)) <= 1.0 + 1e-6, "the last one, where there are several"
        else:
            assert sample.zero_pulse is None
        before = revolutions


def test_the_place_of_the_zero_pulse_knows_of_the_acceleration() -> None:
    """A revolution after 2 s from standstill, in an interval from 1.9 s to 2.1 s."""
    one = source(Motion((Ramp(10.0, 300.0),)))
    for at in (0.0, 1.9, 2.1):
        sample = one.sample_at(at)
    assert sample.zero_pulse == pytest.approx(0.5)


def test_aperture_jitter_moves_the_instant_by_its_rms_and_four_times_that_at_most() -> None:
    rms_s = 50e-9
    one = source(Motion((), start_rpm=60.0), aperture_jitter_s=rms_s)
    off = []
    for n in range(3000):
        one.sample_at(n * 1e-3)
        off.append(one.position_cycles / 2500 - n * 1e-3)
    assert statistics.pstdev(off[1:]) == pytest.approx(rms_s, rel=0.05)
    assert 2.8 * rms_s < max(map(abs, off)) <= 4.001 * rms_s


def test_for_a_module_that_samples_itself_an_interval_passes_with_each_sample() -> None:
    one = source(Motion((), start_rpm=60.0))
    first, *_ = [one.next() for _ in range(3)]
    assert first == Sample(0, 1500)
    assert one.position_cycles == pytest.approx(5.0)
