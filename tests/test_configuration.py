"""The YAML of the commands: what is right loads, what is wrong gets one line with file, line and key."""

import re
from pathlib import Path

import pytest
import yaml
from hypothesis import given, strategies as st

import canfb
from canfb import Conditioning, ConfigError
from canfb.configuration import Config, RealtimeConfig, parse_config
from canfb.simulation.encoder import Ramp, Ripple
from canfb.simulation.scenario import HarmonicConfig
from drawing import examples
from folding import each

# The YAML of section 3 of the design, as it stands there.
DESIGN = """\
bus: {interface: socketcan, channel: can0, bitrate: 1000000}      # python-can's parameters
modules:                                                          # one process serves several nodes
  - node_id: 0x20
    encoder_interface: 0x10          # the node whose TPDO1 carries the ADC counts
    cycles_per_revolution: 2500
    adc_bits: 12
    times: true                      # the ADC PDO carries the interface's sample time (2000:05) behind them
    state_dir: /var/lib/canfb/x      # where `save` (1010h) keeps table and parameters
    autostart: false                 # true: OPERATIONAL without a master
realtime: {priority: 80, lock_memory: true, cpu: 3}
"""

SIMULATION = """\
modules:
  - {node_id: 33, conditioning: {sine_offset_counts: -12, cosine_gain: 1.05}, residual_limit: 0.25}
  - {node_id: 34, encoder_interface: 17, max_acceleration_rad_s2: 1e5}
simulation:
  seed: 7
  encoder: {amplitude: 0.5, noise_lsb: 0, harmonics: [{order: 3, sine: 0.01}, {order: 5, cosine: 1e-3}]}
  motion: {rpm: -60, standstill_s: 1, ramp_s: 3, ripple_rpm: 2, ripple_hz: 4}
"""


def test_the_yaml_of_the_design_loads_as_it_stands(tmp_path: Path) -> None:
    path = tmp_path / "feedback.yaml"
    path.write_text(DESIGN, encoding="utf-8")
    config = canfb.load_config(path)
    assert config.bus == {"interface": "socketcan", "channel": "can0", "bitrate": 1000000}
    assert config.realtime == RealtimeConfig(priority=80, lock_memory=True, cpu=3)
    assert config.modules == [
        canfb.ModuleConfig(
            node_id=0x20,
            encoder_interface=0x10,
            cycles_per_revolution=2500,
            adc_bits=12,
            times=True,
            state_dir="/var/lib/canfb/x",
            autostart=False,
        )
    ]
    assert canfb.load_config(str(path)) == config


def test_everything_nested_becomes_what_it_stands_for() -> None:
    config = parse_config(SIMULATION)
    first, second = config.modules
    assert first.conditioning == Conditioning(sine_offset_counts=-12, cosine_gain=1.05)
    assert first.residual_limit == 0.25
    assert (second.encoder_interface, second.max_acceleration_rad_s2) == (17, 1e5)
    simulation = config.simulation
    assert simulation.seed == 7
    assert simulation.encoder.harmonics == [
        HarmonicConfig(order=3, sine=0.01),
        HarmonicConfig(order=5, cosine=1e-3),
    ]
    encoder = simulation.encoder.encoder(12)
    assert (encoder.amplitude_counts, encoder.noise_lsb, encoder.adc_bits) == (1024.0, 0, 12)
    assert [h.order for h in encoder.harmonics] == [3, 5]
    motion = simulation.motion.motion()
    assert motion.ramps == (Ramp(1, 0.0), Ramp(3, -60))
    assert motion.ripples == (Ripple(2, 4),)


def test_what_is_left_out_has_its_default() -> None:
    config = parse_config("modules: [{node_id: 5}]")
    assert (
        parse_config("modules: [{node_id: 5, second_position: null}]\nsimulation:").modules == config.modules
    )
    assert config == Config(modules=[canfb.ModuleConfig(node_id=5)])
    assert config.realtime == RealtimeConfig(priority=0, lock_memory=False, cpu=None)
    assert config.simulation.motion.motion().ripples == ()


@each("value, number", [("1e6", 1e6), ("1E+6", 1e6), ("1.5e6", 1.5e6), ("1.e-3", 1e-3), ("-2e0", -2.0)])
def test_numbers_with_an_exponent_are_numbers(value: str, number: float) -> None:
    assert parse_config(f"modules: [{{node_id: 5}}]\nbus: {{bitrate: {value}}}").bus["bitrate"] == number


@pytest.mark.parametrize("text", ["1e", "e6", "1e6x", "0x20e", "can1e6"])
def test_what_only_looks_like_a_number_stays_text_or_what_it_was(text: str) -> None:
    value = parse_config(f"modules: [{{node_id: 5}}]\nbus: {{channel: {text}}}").bus["channel"]
    assert value == (0x20E if text == "0x20e" else text)


def test_one_block_may_serve_several_modules_by_an_anchor() -> None:
    config = parse_config(
        "modules:\n"
        "- {node_id: 32, conditioning: &c {sine_gain: 1.1}}\n"
        "- {node_id: 33, encoder_interface: 17, conditioning: *c}\n"
    )
    assert config.modules[0].conditioning == config.modules[1].conditioning == Conditioning(sine_gain=1.1)


def test_a_byte_order_mark_and_windows_line_ends_do_no_harm(tmp_path: Path) -> None:
    path = tmp_path / "windows.yaml"
    path.write_bytes(b"\xef\xbb\xbfmodules:\r\n- node_id: 5\r\n")
    assert canfb.load_config(path).modules[0].node_id == 5


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    path = tmp_path / "nothing.yaml"
    with pytest.raises(ConfigError, match=re.escape(f"{path}: cannot be read: No such file or directory")):
        canfb.load_config(path)
    with pytest.raises(ConfigError, match=re.escape(f"{tmp_path}: cannot be read: Is a directory")):
        canfb.load_config(tmp_path)


@pytest.mark.parametrize(
    ("data", "line"),
    [(b"\xff\xfeb\0u\0s\0", 1), (b"bus: {}\nmodules: \xe9\n", 2), (bytes(range(128, 256)), 1)],
    ids=["UTF-16", "Latin-1", "bytes"],
)
def test_a_file_that_is_not_utf_8(tmp_path: Path, data: bytes, line: int) -> None:
    path = tmp_path / "old.yaml"
    path.write_bytes(data)
    with pytest.raises(ConfigError, match=re.escape(f"{path}:{line}: this is not UTF-8 text")):
        canfb.load_config(path)


def loaded_or_refused(text: str) -> Config | None:
    """What the text says; None if it was refused, in one line."""
    try:
        config = parse_config(text, "f.yaml")
    except ConfigError as error:
        message = str(error)
    else:
        assert isinstance(config, Config)
        assert config.modules
        return config
    assert re.fullmatch(r"f\.yaml:[0-9]+: \S[^\n]*", message)
    return None


@given(st.text())
def test_any_text_loads_or_is_refused(text: str) -> None:
    loaded_or_refused(text)


# Words that matter to YAML and to us, so that more than the first character gets read.
TOKENS = r"""
    modules node_id bus simulation encoder harmonics realtime conditioning priority 1 99 true yes _ . - # = ~
    [ ] { } , --- ... *a << !!int !!bool !!timestamp !!binary !!python/object:os.system !!set !!omap !x
    ' " \ 0x 0b .inf .nan 1e9 1:2 2001-01-01 é
"""
SPACED = [
    ": ", ":\n", "- ", "\n", "\n  ", "\n- ", "? ", "| ", "> ",
    "&a ", "%YAML 1.1", " ", "\t", "\x85", "\u2028", "\0",
]  # fmt: skip
WORDS = st.sampled_from(TOKENS.split() + SPACED)


@examples(400)
@given(st.lists(WORDS, max_size=25).map("".join))
def test_anything_that_looks_like_yaml_loads_or_is_refused(text: str) -> None:
    loaded_or_refused(text)


values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=8), inner, max_size=3)
    ),
    max_leaves=6,
)
KEYS = ("node_id", "encoder_interface", "cycles_per_revolution", "adc_bits", "amplitude_low_counts",
        "amplitude_high_counts", "residual_limit", "coast_samples", "conditioning", "max_acceleration_rad_s2",
        "state_dir", "serial_number", "autostart", "frozen_samples", "coarse_limit_revolutions",
        "source", "predict", "times", "nominal_sync", "sync_timeout_periods",
        "samples_per_sync", "noise_margin", "write_lock", "unlock_code",
        "second_position", "phase_error_cycles", "bad_samples",
        "doubt_acceleration_cycles",
        "corner_hz", "cosine_corner_hz", "interval_s", "adapt", "sync_jitter_s", "answer_delay_s",
        "max_acceleration_cycles")  # fmt: skip


@given(
    st.dictionaries(st.sampled_from(KEYS), values, max_size=4), st.dictionaries(st.text(max_size=8), values)
)
def test_any_value_of_a_key_loads_or_is_refused(module: dict[str, object], bus: dict[str, object]) -> None:
    loaded_or_refused(yaml.safe_dump({"modules": [{"node_id": 3} | module], "bus": bus}, allow_unicode=True))


def test_the_keys_above_are_all_that_a_module_has() -> None:
    assert set(KEYS) == set(canfb.ModuleConfig.__dataclass_fields__)
