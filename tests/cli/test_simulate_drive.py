"""canfb simulate with a drive: the configuration, and the whole network on python-can's virtual bus."""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import Any

import pytest

from canfb.bus.frame_bus import PythonCanBus
from canfb.bus.runner import Runner
from canfb.configuration import Config, parse_config
from canfb.device.device_protocol import Device
from canfb.errors import ConfigError
from canfb.hosting.simulating import fed_module
from canfb.interface.encoder_interface import EncoderInterface
from canfb.module.feedback_module import FeedbackModule
from canfb.simulation.cia402.plant import DriveConfig
from canfb.simulation.cia402.state_machine import State
from canfb.simulation.set_up import SimulatedAxis, simulated_axis
from fake_bus import FakeBus, FakeClock, message

MODULES = "modules: [{node_id: 0x20, encoder_interface: 0x10}]\n"


def parsed(drive: str, modules: str = MODULES) -> Config:
    return parse_config(f"{modules}simulation:\n  drive: {drive}\n", "drive.yaml")


def axis_of(config: Config, rate_hz: float | None = None, module: int = 0) -> SimulatedAxis | None:
    return simulated_axis(
        config.simulation, fed_module(config.modules[module]), autostart=True, rate_hz=rate_hz
    )


def test_without_the_section_there_is_no_drive() -> None:
    assert parse_config(MODULES).simulation.drive is None
    assert axis_of(parse_config(MODULES)) is None


def test_the_yaml_of_the_page_is_a_drive() -> None:
    page = (Path(__file__).parents[2] / "docs" / "simulation.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    (drive,) = [config for config in map(parse_config, blocks) if config.simulation.drive is not None]
    axis = axis_of(drive, 1000.0)
    assert axis is not None
    assert axis.demand is not None
    assert axis.demand.warning() is None


def test_each_key_is_read_and_has_a_default() -> None:
    assert parsed("{}").simulation.drive == DriveConfig()
    keys: dict[str, Any] = {
        "node_id": 0x31,
        "inertia_kg_m2": 2e-3,
        "load_at_s": 3.0,
        "synchronous_feedback": True,
    }
    assert parsed(json.dumps(keys)).simulation.drive == DriveConfig(**keys)


@pytest.mark.parametrize(
    ("drive", "line", "words"),
    [
        ("{inertia_kg_m2: 0}", 3, "inertia_kg_m2 must be a number 1e-09..1e+06, not 0"),
        ("\n    coulomb_friction_nm: -1", 4, "coulomb_friction_nm must be a number 0..1e+06, not -1"),
        ("{rated_torque_nm: yes}", 3, "rated_torque_nm must be a number"),
        ("{node_id: 128}", 3, "node_id must be"),
        ("{synchronous_feedback: 1}", 3, "synchronous_feedback must be true or false"),
        ("{inertia: 1}", 3, "unknown key 'inertia' in drive"),
        ("{brake_torque_nm: .nan}", 3, "brake_torque_nm must be a number"),
        ("{start_revolutions: 1e7}", 3, "start_revolutions must be a number"),
        ("7", 3, "drive must be a mapping"),
        ("\n    load_at_s: 1\n    node_id: 0x20", 5, "node_id 32 is the node_id of modules[0]"),
        ("{node_id: 16}", 3, "node_id 16 is the encoder_interface of modules[0]"),
    ],
)
def test_a_wrong_value_is_refused_with_its_line(drive: str, line: int, words: str) -> None:
    with pytest.raises(ConfigError) as refused:
        parsed(drive)
    assert str(refused.value).startswith(f"drive.yaml:{line}: ")
    assert words in str(refused.value)


def test_the_node_of_the_default_is_looked_at_as_well() -> None:
    with pytest.raises(ConfigError, match=r"drive\.yaml:3: drive: node_id 48 is the node_id of modules\[0\]"):
        parsed("{}", "modules: [{node_id: 48}]\n")


def test_a_module_that_samples_itself_has_no_encoder_interface() -> None:
    module = "modules: [{node_id: 32, encoder_interface: 48, source: {kind: motion}}]\n"
    assert parsed("{}", module).simulation.drive is not None


def test_a_module_without_a_node_id_has_no_position_to_take() -> None:
    with pytest.raises(ConfigError, match="no node_id"):
        axis_of(parsed("{}", "modules: [{node_id: 255, encoder_interface: 0x10}]\n"))


def test_the_drive_is_set_up_for_its_module() -> None:
    modules = (
        "modules: [{node_id: 0x20}, {node_id: 0x21, encoder_interface: 0x11, cycles_per_revolution: 512}]\n"
    )
    axis = axis_of(parsed("{synchronous_feedback: true}", modules), 500.0, module=1)
    assert axis is not None
    values = {
        place: axis.drive.dictionary.entry(*place).value
        for place in ((0x1403, 1), (0x1403, 2), (0x2110, 7), (0x60E6, 1), (0x2100, 5), (0x6076, 0))
    }
    assert values == {
        (0x1403, 1): 0x1A1,
        (0x1403, 2): 1,
        (0x2110, 7): 0xA1,
        (0x60E6, 1): 512 * 8192,
        (0x2100, 5): 10_000,
        (0x6076, 0): 500,
    }
    assert axis.describe() == "drive: node 48 (30h), position from node 33 (21h)"


@pytest.mark.parametrize(
    ("rate", "words"),
    [
        (1000.0, None),
        (
            500.0,
            "510 rad/s^2, it follows 209 at 500 Hz: set --rate to 850 or more, or write 336 or less to 6072h",
        ),
        (100.0, "it follows 8.38 at 100 Hz: set --rate to 850 or more, or less friction and torque"),
    ],
)
def test_a_motor_that_the_module_cannot_follow_is_told(rate: float, words: str | None) -> None:
    axis = axis_of(parsed("{}"), rate)
    assert axis is not None
    assert axis.demand is not None
    assert axis.demand.describe().startswith(
        f"drive: up to {125000 / rate:.3g} cycles per sample, acceleration"
    )
    assert (axis.demand.warning() or "").endswith(words or "")
    assert (axis.demand.warning() is None) is (words is None)


def test_without_a_rate_of_its_own_nothing_is_known_of_what_the_module_follows() -> None:
    axis = axis_of(parsed("{}"))
    assert axis is not None
    assert axis.demand is None


def test_all_in_one_process_on_a_runner_move_the_shaft() -> None:
    """The order of the devices, and frames between them, are those of the command."""
    config = parsed("{}")
    axis = axis_of(config)
    assert axis is not None
    plan = [(1e-3 * n, message(0x080)) for n in range(1, 601)]
    plan += [(2e-3, message(0x000, b"\x01\x20"))]
    plan += [
        (1e-3 * at, message(0x230, struct.pack("<Hb", controlword, 8)))
        for at, controlword in ((20, 0x06), (21, 0x07), (22, 0x0F))
    ]
    plan += [(1e-3 * n, message(0x330, struct.pack("<i", 1000))) for n in range(30, 601)]
    clock = FakeClock()
    bus = FakeBus(clock, sorted(plan, key=lambda one: one[0]))
    interface = EncoderInterface(0x10, axis.source, autostart=True)
    devices: list[Device] = [axis.plant, interface, axis.drive, FeedbackModule(config.modules[0])]
    Runner(PythonCanBus(bus), devices, clock=clock, sleep=clock.sleep).run(lambda: not bus.plan)  # type: ignore[arg-type]
    assert axis.drive.power is State.OPERATION_ENABLED, axis.summary()
    assert axis.plant.motor.revolutions * 2**20 == pytest.approx(1000, abs=20)
    assert axis.summary() == "drive: Operation enabled; the shaft is at 0.001 revolutions"
