"""What is wrong with a configuration gets one line with file, line and key."""

import pytest

from canfb.configuration import parse_config
from canfb.errors import ConfigError
from folding import each


def refused(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        parse_config(text, "f.yaml")
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 350
    return message


MODULE = "modules:\n- node_id: 3\n"
BRIEF = "modules: [{node_id: 3}]\n"
SECOND = MODULE + "  second_position: {increments: 1, "
DRIVE = "simulation:\n  drive: "
# Text: the line, and words of the message.
WRONG = {
    **dict.fromkeys(("", "# nothing\n"), "1: the configuration is empty; 'canfb config example' prints one"),
    "- node_id: 3\n": "1: the configuration must be a mapping of keys to values",
    "canfb\n": "1: the configuration must be a mapping",
    "bus: {}\n": "1: 'modules' is missing: a list with at least one module",
    "modules: []\n": "1: 'modules' is missing: a list with at least one module",
    "bus: {}\nmodules: {node_id: 3}\n": "2: 'modules' in the configuration must be a list",
    "modules:\n- node_id: 3\n- 4\n": "3: modules[1] must be a mapping of keys to values",
    "modules:\n- adc_bits: 12\n": "2: 'node_id' is missing in modules[0]",
    MODULE + "  adc_bit: 12\n": "3: unknown key 'adc_bit' in modules[0]; did you mean 'adc_bits'?",
    BRIEF + "realtime: {speed: 3}\n":
        "2: unknown key 'speed' in realtime; known: priority, lock_memory, cpu, busy_poll",
    "module: []\n": "1: unknown key 'module' in the configuration; did you mean 'modules'?",
    MODULE + "  conditioning:\n    sine_gian: 1\n":
        "4: unknown key 'sine_gian' in conditioning; did you mean 'sine_gain'?",
    "simulation:\n  encoder:\n    harmonics:\n    - {order: 2}\n    - {ordre: 2}\n":
        "5: unknown key 'ordre' in harmonics[1]; did you mean 'order'?",
    MODULE + "  adc_bits: 12\n  node_id: 4\n": "4: key 'node_id' is already in line 2",
    "bus: {}\nbus: {}\n": "2: key 'bus' is already in line 1",
    **{
        f"modules:\n- node_id: {text}\n": f"2: modules[0]: node_id must be a whole number 1..127, not {value}"
        for text, value in {"three": "'three'", "3.5": 3.5, "true": True, "": None, "0": 0}.items()
    },
    "modules:\n- node_id: [3]\n": "2: 'node_id' in modules[0] must be a single value",
    "modules:\n- node_id: {a: 3}\n": "2: 'node_id' in modules[0] must be a single value",
    MODULE + "  adc_bits: 012\n": "3: adc_bits must be a whole number 4..16, not '012'",
    MODULE + "  conditioning: {sine_gain: yes}\n": "3: sine_gain must be a finite number, not True",
    MODULE + "  coast_samples: 3\n  conditioning: {sine_offset_counts: 1e39}\n":
        "4: modules[0]: conditioning: sine_offset_counts must be a number -3.4e+38..3.4e+38, not 1e+39",
    MODULE + "  autostart: 1\n": "3: autostart must be true or false, not 1",
    MODULE + "  state_dir: 4\n": "3: state_dir must be text, not 4",
    MODULE + '  state_dir: "a\\ud83d"\n': r"3: state_dir must be text, not 'a\ud83d'",
    MODULE + "  samples_per_sync: 2\n  source: {kind: iio, device: x, scans_per_sync: 5}\n":
        "3: modules[0]: samples_per_sync: 2 need scans_per_sync in source, a multiple of it, not 5",
    MODULE + "  adapt: 3\n": "3: modules[0]: adapt must be true, false or a mapping with its bounds, not 3",
    MODULE + "  adapt: {offset: 0.3}\n": "3: adapt: offset must be a number 0..0.25, not 0.3",
    MODULE + "  adapt: {gain: yes}\n": "3: adapt: gain must be a number 0..0.5, not True",
    MODULE + "  adapt: {rate: 1}\n":
        "3: unknown key 'rate' in adapt; known: offset, gain, phase_rad, rate_per_hour",
    MODULE + "  adapt: [1]\n": "3: adapt must be a mapping",
    SECOND + "cob_id: 0x180}\n": "3: second_position: cob_id must be a whole number 385..1407, not 384",
    SECOND + "cob_id: 0x600}\n": "3: second_position: cob_id must be",
    SECOND + "cob_id: 0x183}\n": "3: second_position: cob_id 0x183 is that of a PDO of the module",
    SECOND + "before_bytes: 5}\n": "3: second_position: before_bytes must be a whole number 0..4, not 5",
    SECOND + "after_bytes: -1}\n": "3: second_position: after_bytes must be",
    SECOND + "cob_id: 0x1B0}\n  times: true\n  samples_per_sync: 7\n":
        "3: modules[0]: second_position: no RPDO is left for cob_id",
    MODULE + "  write_lock: on\n": "3: modules[0]: write_lock must be none, preop or code, not True",
    MODULE + "  write_lock: code\n": "3: modules[0]: write_lock: code needs an unlock_code",
    MODULE + "  unlock_code: -1\n": "3: modules[0]: unlock_code must be a whole number 0..4294967295, not -1",
    MODULE + "  unlock_code: 0x100000000\n": "3: modules[0]: unlock_code must be",
    MODULE + "  conditioning: none\n": "3: conditioning must be a mapping",
    "modules:\n- adc_bits: 17\n  node_id: 3\n": "2: adc_bits must be a whole number 4..16, not 17",
    MODULE + "  residual_limit: .nan\n": "3: residual_limit must be above 0",
    MODULE + "  max_acceleration_rad_s2: .inf\n": "3: max_acceleration_rad_s2 must be",
    MODULE + "  sync_timeout_periods: 1\n": "3: sync_timeout_periods must be",
    MODULE + "  nominal_sync: 2\n": "3: nominal_sync must be",
    MODULE + "  predict: 3\n": "3: predict must be false",
    MODULE + "  samples_per_sync: 9\n": "3: samples_per_sync must be a whole number 1..8, not 9",
    MODULE + "  times: true\n  samples_per_sync: 8\n":
        "4: samples_per_sync must be a whole number 1..7, not 8",
    MODULE + "  conditioning:\n    sine_gain: 1\n    cosine_gain: 0\n":
        "5: cosine_gain is out of range: its size must be 0.001 to 1000",
    "simulation:\n  encoder:\n    amplitude: 1\n    sine_amplitude: 1\n    cosine_amplitude: 3\n":
        "5: cosine_amplitude must be a number 0..2, not 3",
    MODULE + "  adc_bits: 8\n  amplitude_low_counts: 200\n":
        "4: amplitude_low_counts must be below amplitude_high_counts",
    "modules:\n- node_id: 16\n": "2: encoder_interface must differ from",
    "modules:\n- node_id: 3\n- node_id: 4\n  encoder_interface: 9\n- node_id: 0x3\n":
        "5: node_id 3 of modules[2] is also that of modules[0]",
    MODULE + "  encoder_interface: 4\n- node_id: 4\n":
        "2: encoder_interface 4 of modules[0] is the node_id of modules[1]",
    BRIEF + "bus: [socketcan]\n": "2: 'bus' must be a mapping of python-can's",
    BRIEF + "bus:\n": "2: 'bus' must be a mapping of python-can's parameters",
    BRIEF + "realtime: {priority: 100}\n": "2: priority must be a whole number 0..99",
    BRIEF + "realtime: {priority: yes}\n": "2: priority must be a whole number",
    BRIEF + "realtime: {lock_memory: 1}\n": "2: lock_memory must be true or",
    **{BRIEF + f"realtime: {{cpu: {n}}}\n": "2: cpu must be a whole number 0.." for n in (-1, "no")},
    BRIEF + "realtime: {cpu: 0, busy_poll: 1}\n": "2: busy_poll",
    BRIEF + "realtime: {busy_poll: true}\n":
        "2: busy_poll needs a processor of its own: set cpu, for example cpu: 3",
    BRIEF + "realtime: {cpu: 0, priority: 1, busy_poll: true}\n":
        "2: busy_poll: omit priority; the kernel halts a program with priority that never sleeps",
    BRIEF + "simulation: {seed: true}\n": "2: seed must be a whole number",
    "simulation:\n  encoder: {harmonics: [{order: 1}]}\n": "2: order must be a whole number 2..50",
    "simulation:\n  motion:\n    ripple_rpm: 1\n    rpm: fast\n": "4: rpm must be a number",
    DRIVE + "{inertia_kg_m2: 0}": "2: inertia_kg_m2 must be a number 1e-09..1e+06, not 0",
    DRIVE + "\n    coulomb_friction_nm: -1": "3: coulomb_friction_nm must be a number 0..1e+06, not -1",
    DRIVE + "{rated_torque_nm: yes}": "2: rated_torque_nm must be a number",
    DRIVE + "{node_id: 128}": "2: node_id must be",
    DRIVE + "{synchronous_feedback: 1}": "2: synchronous_feedback must be true or false",
    DRIVE + "{inertia: 1}": "2: unknown key 'inertia' in drive",
    DRIVE + "{brake_torque_nm: .nan}": "2: brake_torque_nm must be a number",
    DRIVE + "{start_revolutions: 1e7}": "2: start_revolutions must be a number",
    DRIVE + "7": "2: drive must be a mapping",
    BRIEF + DRIVE + "\n    load_at_s: 1\n    node_id: 3": "5: node_id 3 is the node_id of modules[0]",
    BRIEF + DRIVE + "{node_id: 16}": "3: node_id 16 is the encoder_interface of modules[0]",
    f"modules: [{{node_id: 48}}]\n{DRIVE}{{}}": "3: drive: node_id 48 is the node_id of modules[0]",
    "modules: [{node_id: 3}\nbus: {}\n": "2: this is not YAML",
    "modules:\n\t- node_id: 3\n": "2: this is not YAML: while scanning for the next token",
    "a: b: c\n": "1: this is not YAML: mapping values are not allowed here",
    "bus: {}\nmodules: \x00\n": "2: this is not YAML: special characters are not allowed",
    "bus: {}\n---\nbus: {}\n": "2: expected a single document in the stream",
    "modules: *m\n": "1: this is not YAML: found undefined alias 'm'",
    "modules:\n- <<: {adc_bits: 12}\n  node_id: 3\n": "2: '<<' in modules[0] is not a key: merge keys",
    "modules: &m\n- *m\n": "3: more than 100000 values, aliases expanded",
    "modules:\n- !!python/object:os.system {node_id: 3}\n":
        "2: modules[0] has the tag 'tag:yaml.org,2002:python/object:os.system'; a configuration needs none",
    "modules: !!set {a}\n": "1: 'modules' in the configuration must be a list",
    "modules: !!omap []\n": "1: 'modules' in the configuration has the tag",
    BRIEF + "bus: {channel: !!python/name:os.system ''}\n":
        "2: 'channel' in bus cannot be read: could not determine a constructor for the tag",
    "modules:\n- node_id: 2001-99-99\n": "2: 'node_id' in modules[0] cannot be read",
    "modules:\n- node_id: 0x_\n": "2: 'node_id' in modules[0] cannot be read: '0x_'",
    "modules:\n- node_id: !!bool 7\n": "2: 'node_id' in modules[0] cannot be read: '7'",
    "modules:\n- node_id: !!int ''\n": "2: 'node_id' in modules[0] cannot be read: ''",
    "modules:\n- node_id: =\n": "2: 'node_id' in modules[0] cannot be read",
    **dict.fromkeys(("? [a, b]\n: 1\n", "bus: {? {a: b} : 1}\n"), "1: a key must be a single word"),
    '"a\\nb": 1\n': "1: unknown key 'a\\nb' in the configuration",
    f"modules:\n- node_id: {'1' * 5000}\n": "2: 'node_id' in modules[0] cannot be read",
    f"modules:\n- node_id: 0x{'f' * 6000}\n": "2: modules[0]",
    f"{'k' * 1000}: 1\n": "1: unknown key 'kkkkkk",
    f"modules:\n  {'[' * 900}": "2: nested too deeply",
    "{a: " * 3000: "1: nested too deeply",
}  # fmt: skip


@each("text", WRONG)
def test_what_is_wrong_gets_one_line_with_file_line_and_key(text: str) -> None:
    line, _, words = WRONG[text].partition(": ")
    message = refused(text)
    assert message.startswith(f"f.yaml:{line}: ")
    assert words in message


def test_a_bomb_of_aliases_does_not_go_off() -> None:
    """Each list holds the one before ten times: 10^12 words if anybody wrote them all down."""
    lines = ["a0: &a0 [x]"] + [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 13)]
    bomb = "bus:\n" + "".join(f"  {line}\n" for line in lines)
    message = refused(f"{bomb}modules: [{{node_id: 3}}]\n")
    assert message.endswith("more than 100000 values, aliases expanded")
