"""What is wrong with a configuration gets one line with file, line and key."""

from __future__ import annotations

import pytest

from canfb.configuration import parse_config
from canfb.errors import ConfigError


def refused(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        parse_config(text, "f.yaml")
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 350
    return message


# Text, line, and what the message says.
WRONG = {
    "empty": ("", 1, "the configuration is empty; 'canfb config example' prints one"),
    "only a comment": ("# nothing\n", 1, "the configuration is empty"),
    "a list": ("- node_id: 3\n", 1, "the configuration must be a mapping of keys to values"),
    "a word": ("canfb\n", 1, "the configuration must be a mapping"),
    "no modules": ("bus: {}\n", 1, "'modules' is missing: a list with at least one module"),
    "empty modules": ("modules: []\n", 1, "'modules' is missing: a list with at least one module"),
    "modules as a mapping": (
        "bus: {}\nmodules: {node_id: 3}\n",
        2,
        "'modules' in the configuration must be a list",
    ),
    "module as a number": (
        "modules:\n- node_id: 3\n- 4\n",
        3,
        "modules[1] must be a mapping of keys to values",
    ),
    "no node_id": ("modules:\n- adc_bits: 12\n", 2, "'node_id' is missing in modules[0]"),
    "unknown key": (
        "modules:\n- node_id: 3\n  adc_bit: 12\n",
        3,
        "unknown key 'adc_bit' in modules[0]; did you mean 'adc_bits'?",
    ),
    "unknown key, nothing near": (
        "modules: [{node_id: 3}]\nrealtime: {speed: 3}\n",
        2,
        "unknown key 'speed' in realtime; known: priority, lock_memory, cpu, busy_poll",
    ),
    "unknown key at the top": (
        "module: []\n",
        1,
        "unknown key 'module' in the configuration; did you mean 'modules'?",
    ),
    "unknown key two deep": (
        "modules:\n- node_id: 3\n  conditioning:\n    sine_gian: 1\n",
        4,
        "unknown key 'sine_gian' in conditioning; did you mean 'sine_gain'?",
    ),
    "unknown key in a list": (
        "simulation:\n  encoder:\n    harmonics:\n    - {order: 2}\n    - {ordre: 2}\n",
        5,
        "unknown key 'ordre' in harmonics[1]; did you mean 'order'?",
    ),
    "duplicate key": (
        "modules:\n- node_id: 3\n  adc_bits: 12\n  node_id: 4\n",
        4,
        "key 'node_id' is there already, in line 2",
    ),
    "duplicate key at the top": ("bus: {}\nbus: {}\n", 2, "key 'bus' is there already, in line 1"),
    "a word for a number": (
        "modules:\n- node_id: three\n",
        2,
        "modules[0]: node_id must be a whole number 1..127, not 'three'",
    ),
    "a fraction": ("modules:\n- node_id: 3.5\n", 2, "node_id must be a whole number 1..127, not 3.5"),
    "a truth for a number": (
        "modules:\n- node_id: true\n",
        2,
        "node_id must be a whole number 1..127, not True",
    ),
    "nothing for a number": ("modules:\n- node_id:\n", 2, "node_id must be a whole number 1..127, not None"),
    "a list for a number": (
        "modules:\n- node_id: [3]\n",
        2,
        "'node_id' in modules[0] must be a single value",
    ),
    "a mapping for a number": (
        "modules:\n- node_id: {a: 3}\n",
        2,
        "'node_id' in modules[0] must be a single value",
    ),
    "a number for a truth": (
        "modules:\n- node_id: 3\n  autostart: 1\n",
        3,
        "autostart must be true or false, not 1",
    ),
    "a number for a folder": (
        "modules:\n- node_id: 3\n  state_dir: 4\n",
        3,
        "state_dir must be the name of a folder",
    ),
    "a word for a mapping": (
        "modules:\n- node_id: 3\n  conditioning: none\n",
        3,
        "conditioning must be a mapping",
    ),
    "too low": ("modules:\n- node_id: 0\n", 2, "node_id must be a whole number 1..127, not 0"),
    "too high": (
        "modules:\n- adc_bits: 17\n  node_id: 3\n",
        2,
        "adc_bits must be a whole number 4..16, not 17",
    ),
    "not a number": ("modules:\n- node_id: 3\n  residual_limit: .nan\n", 3, "residual_limit must be above 0"),
    "infinite": (
        "modules:\n- node_id: 3\n  max_acceleration_rad_s2: .inf\n",
        3,
        "max_acceleration_rad_s2 must be",
    ),
    "a timeout of one period": (
        "modules:\n- node_id: 3\n  sync_timeout_periods: 1\n",
        3,
        "sync_timeout_periods must be",
    ),
    "a nominal SYNC that is a number": (
        "modules:\n- node_id: 3\n  nominal_sync: 2\n",
        3,
        "nominal_sync must be",
    ),
    "a prediction that there is not": ("modules:\n- node_id: 3\n  predict: 3\n", 3, "predict must be false"),
    "the right one of two names alike": (
        "modules:\n- node_id: 3\n  conditioning:\n    sine_gain: 1\n    cosine_gain: 0\n",
        5,
        "cosine_gain is out of range: its size must be 0.001 to 1000",
    ),
    "the right one of two names alike, again": (
        "simulation:\n  encoder:\n    amplitude: 1\n    sine_amplitude: 1\n    cosine_amplitude: 3\n",
        5,
        "cosine_amplitude must be a number 0..2, not 3",
    ),
    "two that do not fit": (
        "modules:\n- node_id: 3\n  adc_bits: 8\n  amplitude_low_counts: 200\n",
        4,
        "amplitude_low_counts must be below amplitude_high_counts",
    ),
    "node_id is that of the interface": (
        "modules:\n- node_id: 16\n",
        2,
        "encoder_interface must differ from",
    ),
    "one node_id twice": (
        "modules:\n- node_id: 3\n- node_id: 4\n  encoder_interface: 9\n- node_id: 0x3\n",
        5,
        "node_id 3 of modules[2] is also that of modules[0]",
    ),
    "a module for an interface": (
        "modules:\n- node_id: 3\n  encoder_interface: 4\n- node_id: 4\n",
        2,
        "encoder_interface 4 of modules[0] is the node_id of modules[1]",
    ),
    "bus as a list": (
        "modules: [{node_id: 3}]\nbus: [socketcan]\n",
        2,
        "'bus' must be a mapping of python-can's",
    ),
    "bus as nothing": (
        "modules: [{node_id: 3}]\nbus:\n",
        2,
        "'bus' must be a mapping of python-can's parameters",
    ),
    "priority too high": (
        "modules: [{node_id: 3}]\nrealtime: {priority: 100}\n",
        2,
        "priority must be a whole number 0..99",
    ),
    "priority a truth": (
        "modules: [{node_id: 3}]\nrealtime: {priority: yes}\n",
        2,
        "priority must be a whole number",
    ),
    "lock_memory a number": (
        "modules: [{node_id: 3}]\nrealtime: {lock_memory: 1}\n",
        2,
        "lock_memory must be true or",
    ),
    "cpu below zero": ("modules: [{node_id: 3}]\nrealtime: {cpu: -1}\n", 2, "cpu must be a whole number 0.."),
    "busy_poll no truth": ("modules: [{node_id: 3}]\nrealtime: {cpu: 0, busy_poll: 1}\n", 2, "busy_poll"),
    "busy_poll on any processor": (
        "modules: [{node_id: 3}]\nrealtime: {busy_poll: true}\n",
        2,
        "busy_poll needs a processor of its own: set cpu, for example cpu: 3",
    ),
    "busy_poll with priority": (
        "modules: [{node_id: 3}]\nrealtime: {cpu: 0, priority: 1, busy_poll: true}\n",
        2,
        "busy_poll: omit priority; the kernel halts a program with priority that never sleeps",
    ),
    "cpu a truth": ("modules: [{node_id: 3}]\nrealtime: {cpu: no}\n", 2, "cpu must be a whole number 0.."),
    "seed a truth": ("modules: [{node_id: 3}]\nsimulation: {seed: true}\n", 2, "seed must be a whole number"),
    "order too low": (
        "simulation:\n  encoder: {harmonics: [{order: 1}]}\n",
        2,
        "order must be a whole number 2..50",
    ),
    "rpm a word": ("simulation:\n  motion:\n    ripple_rpm: 1\n    rpm: fast\n", 4, "rpm must be a number"),
    # Not YAML, or more YAML than a configuration needs.
    "a bracket left open": ("modules: [{node_id: 3}\nbus: {}\n", 2, "this is not YAML"),
    "a tabulator": ("modules:\n\t- node_id: 3\n", 2, "this is not YAML: while scanning for the next token"),
    "two colons": ("a: b: c\n", 1, "this is not YAML: mapping values are not allowed here"),
    "a control character": (
        "bus: {}\nmodules: \x00\n",
        2,
        "this is not YAML: special characters are not allowed",
    ),
    "two documents": ("bus: {}\n---\nbus: {}\n", 2, "expected a single document in the stream"),
    "an alias without an anchor": ("modules: *m\n", 1, "this is not YAML: found undefined alias 'm'"),
    "a merge key": ("modules:\n- <<: {adc_bits: 12}\n  node_id: 3\n", 2, "unknown key '<<' in modules[0]"),
    "an alias of itself": ("modules: &m\n- *m\n", 3, "the file stands for more than 100000 values"),
    "an object of Python": (
        "modules:\n- !!python/object:os.system {node_id: 3}\n",
        2,
        "modules[0] has the tag 'tag:yaml.org,2002:python/object:os.system'; a configuration needs none",
    ),
    "a list that is a set": ("modules: !!set {a}\n", 1, "'modules' in the configuration must be a list"),
    "a list with a tag": ("modules: !!omap []\n", 1, "'modules' in the configuration has the tag"),
    "a name of Python": (
        "modules: [{node_id: 3}]\nbus: {channel: !!python/name:os.system ''}\n",
        2,
        "'channel' in bus cannot be read: could not determine a constructor for the tag",
    ),
    "a day that there is not": (
        "modules:\n- node_id: 2001-99-99\n",
        2,
        "'node_id' in modules[0] cannot be read",
    ),
    "half a number": ("modules:\n- node_id: 0x_\n", 2, "'node_id' in modules[0] cannot be read: '0x_'"),
    "a tag that does not fit": (
        "modules:\n- node_id: !!bool 7\n",
        2,
        "'node_id' in modules[0] cannot be read: '7'",
    ),
    "a tag on nothing": ("modules:\n- node_id: !!int ''\n", 2, "'node_id' in modules[0] cannot be read: ''"),
    "an equals sign": ("modules:\n- node_id: =\n", 2, "'node_id' in modules[0] cannot be read"),
    "a list as a key": ("? [a, b]\n: 1\n", 1, "a key must be a single word"),
    "a mapping as a key of bus": ("bus: {? {a: b} : 1}\n", 1, "a key must be a single word"),
    "a line end in a key": ('"a\\nb": 1\n', 1, r"unknown key 'a\nb' in the configuration"),
    "a number without end": (
        f"modules:\n- node_id: {'1' * 5000}\n",
        2,
        "'node_id' in modules[0] cannot be read",
    ),
    "a number that cannot be shown": (f"modules:\n- node_id: 0x{'f' * 6000}\n", 2, "modules[0]"),
    "a key without end": (f"{'k' * 1000}: 1\n", 1, "unknown key 'kkkkkk"),
    "brackets without end": (f"modules:\n  {'[' * 900}", 2, "nested too deeply"),
    "mappings without end": ("{a: " * 3000, 1, "nested too deeply"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_gets_one_line_with_file_line_and_key(case: str) -> None:
    text, line, words = WRONG[case]
    message = refused(text)
    assert message.startswith(f"f.yaml:{line}: ")
    assert words in message


def test_a_bomb_of_aliases_does_not_go_off() -> None:
    """Each list holds the one before ten times: 10^12 words if anybody wrote them all down."""
    lines = ["a0: &a0 [x]"] + [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 10)}]" for n in range(1, 13)]
    bomb = "bus:\n" + "".join(f"  {line}\n" for line in lines)
    message = refused(f"{bomb}modules: [{{node_id: 3}}]\n")
    assert message.endswith("the file stands for more than 100000 values")
