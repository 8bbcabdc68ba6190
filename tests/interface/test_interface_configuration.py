"""``interfaces:`` of the YAML: what is right loads, what is wrong gets one line with file, line and key."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest
import yaml

from canfb.configuration import INTERFACES, parse_config
from canfb.errors import ConfigError
from canfb.interface.interface_config import InterfaceConfig
from canfb.sources.iio_source import IioSourceConfig
from commands import Command
from folding import each

ADC = "source: {kind: iio, device: ads7950}"
BOTH = f"""\
modules:
  - {{node_id: 0x20, encoder_interface: 0x10}}
interfaces:
  - {{node_id: 0x10, {ADC}, times: true}}
"""


def test_every_key_is_read() -> None:
    text = (
        "interfaces:\n- {node_id: 0x10, source: {kind: iio, device: x, scans_per_sync: 4}, serial_number: 7,"
        " times: true, samples_per_sync: 2, adc_bits: 14, cycles_per_revolution: 1024, state_dir: /tmp/x,"
        " autostart: true}\n"
    )
    (config,) = parse_config(text, needs=INTERFACES).interfaces
    (keys,) = yaml.safe_load(text)["interfaces"]
    converter = IioSourceConfig(device="x", scans_per_sync=4, adc_bits=14, samples_per_sync=2)
    assert config == InterfaceConfig(**keys | {"source": converter})
    assert set(keys) == {field.name for field in dataclasses.fields(InterfaceConfig)}


ONE = "interfaces:\n- node_id: 16\n"
# Text: the line, and words of the message.
WRONG = {
    "modules: [{node_id: 3}]": "1: 'interfaces' is missing: a list with at least one encoder interface",
    ONE: "2: 'source' is missing in interfaces[0]",
    f"{ONE}  source: null\n": "3: interfaces[0]: source must be a configuration of a source, not None",
    f"{ONE}  {ADC}\n  residual_limit: 0.3\n": "4: unknown key 'residual_limit' in interfaces[0]",
    f"{ONE}  {ADC}\n  samples_per_sync: 9\n": "4: samples_per_sync must be a whole number 1..8, not 9",
    f"interfaces: [{{node_id: 128, {ADC}}}]": "1: node_id must be a whole number 1..127",
    f"interfaces: [{{node_id: 1, {ADC}, state_dir: 4}}]": "1: state_dir must be text, not 4",
    f"interfaces: [{{node_id: 1, {ADC}, times: 1}}]": "1: times must be true or false, not 1",
    BOTH.replace("id: 0x10, s", "id: 0x20, s"): "4: node_id 32 of interfaces[0] is also that of modules[0]",
    f"interfaces:\n- {{node_id: 16, {ADC}}}\n- {{node_id: 16, {ADC}}}\n": (
        "3: node_id 16 of interfaces[1] is also that of interfaces[0]"
    ),
    f"modules: [{{node_id: 3, state_dir: x}}]\ninterfaces:\n- {{node_id: 16, {ADC}, state_dir: ./x}}\n": (
        "3: state_dir of interfaces[0] is also that of modules[0]"
    ),
    f"interfaces:\n- {{node_id: 255, {ADC}}}\n- {{node_id: 255, {ADC}}}\n": (
        "3: serial_number 0 of interfaces[1] is also that of interfaces[0]: LSS needs unique ones"
    ),
    f"interfaces: [{{node_id: 48, {ADC}}}]\nsimulation: {{drive: {{node_id: 48}}}}\n": (
        "2: drive: node_id 48 is the node_id of interfaces[0]"
    ),
}


@each("text", WRONG)
def test_what_is_wrong_is_told_with_its_line(text: str) -> None:
    line, _, words = WRONG[text].partition(": ")
    with pytest.raises(ConfigError) as caught:
        parse_config(text, "f.yaml", INTERFACES)
    assert str(caught.value).startswith(f"f.yaml:{line}: ")
    assert words in str(caught.value)


def test_the_commands_take_one_or_both_lists(tmp_path: Path, command: Command) -> None:
    path = tmp_path / "interface.yaml"
    one = f"interfaces: [{{node_id: 16, {ADC}}}]"
    for text, nodes in ((one, "interfaces: 10h"), (BOTH, "modules: 20h; interfaces: 10h")):
        path.write_text(text)
        assert command("config check", path).out == f"{path}: valid; {nodes}\n"
    path.write_text("bus: {interface: virtual, channel: none}\n")
    assert "'modules' or 'interfaces' is missing" in command("run", path, code=2).err
