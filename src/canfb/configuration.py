"""The YAML of ``canfb run`` and ``canfb simulate``: its keys are the fields of the classes.

Every message names the file, the line and the key::

    feedback.yaml:4: unknown key 'adc_bit' in modules[0]; did you mean 'adc_bits'?
"""

from __future__ import annotations

import dataclasses
import difflib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from canfb.errors import ConfigError
from canfb.module.config import ModuleConfig
from canfb.signal.conditioning import Conditioning
from canfb.simulation.scenario import EncoderScenario, HarmonicConfig, MotionConfig, SimulationConfig


@dataclass(frozen=True, kw_only=True)
class RealtimeConfig:
    """Real-time options of the process: SCHED_FIFO priority 0..99 (0 = off), locked memory, one CPU."""

    priority: int = 0
    lock_memory: bool = False
    cpu: int | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.priority, int) or not 0 <= self.priority <= 99:
            raise ValueError(f"priority must be a whole number 0..99, not {self.priority!r}")
        if not isinstance(self.lock_memory, bool):
            raise ValueError(f"lock_memory must be true or false, not {self.lock_memory!r}")
        if self.cpu is not None and (not isinstance(self.cpu, int) or self.cpu < 0):
            raise ValueError(f"cpu must be the number of a processor, not {self.cpu!r}")


@dataclass(frozen=True)
class Config:
    """A configuration, validated.

    bus          python-can's own words (interface, channel, bitrate, ...), may be empty
    modules      the drive feedback modules of this process
    realtime     real-time options
    simulation   what ``canfb simulate`` plays
    """

    bus: dict[str, Any] = field(default_factory=dict)
    modules: list[ModuleConfig] = field(default_factory=list)
    realtime: RealtimeConfig = field(default_factory=RealtimeConfig)
    simulation: SimulationConfig = field(default_factory=SimulationConfig)


# Which dataclass a key holds; a list holds several.
_NESTED: dict[str, type] = {
    "modules": ModuleConfig,
    "realtime": RealtimeConfig,
    "conditioning": Conditioning,
    "simulation": SimulationConfig,
    "encoder": EncoderScenario,
    "motion": MotionConfig,
    "harmonics": HarmonicConfig,
}
_LISTS = frozenset({"modules", "harmonics"})


def load_config(path: str | Path) -> Config:
    """Read and validate a configuration. ConfigError that names file, line and key for a bad one."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise ConfigError(f"{path}: cannot be read: {reason}") from None
    return parse_config(text, str(path))


def parse_config(text: str, name: str = "configuration") -> Config:
    """:func:`load_config` for a text; ``name`` stands in the messages for the file."""
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise ConfigError(f"{name}:{line}: this is not YAML: {error.problem}") from None
    except yaml.YAMLError as error:
        raise ConfigError(f"{name}: this is not YAML: {error}") from None
    if root is None:
        raise ConfigError(f"{name}:1: the configuration is empty; 'canfb config example' prints one")
    reader = _Reader(name)
    config: Config = reader.read(root, Config, "the configuration")
    if not config.modules:
        raise ConfigError(f"{name}:1: 'modules' is missing: a list with at least one module")
    reader.check_distinct_nodes(root, config)
    return config


class _Reader:
    """Turns YAML nodes into dataclasses and keeps the line of every key."""

    def __init__(self, name: str) -> None:
        self._name = name

    def fail(self, node: yaml.Node, text: str) -> ConfigError:
        return ConfigError(f"{self._name}:{node.start_mark.line + 1}: {text}")

    def read(self, node: yaml.Node, kind: type, where: str) -> Any:
        """One mapping as a ``kind``."""
        if not isinstance(node, yaml.MappingNode):
            raise self.fail(node, f"{where} must be a mapping of keys to values")
        known = [f.name for f in dataclasses.fields(kind)]
        values: dict[str, Any] = {}
        lines: dict[str, yaml.Node] = {}
        for key_node, value_node in node.value:
            key = str(getattr(key_node, "value", key_node))
            if key not in known:
                raise self.fail(key_node, self._unknown(key, known, where))
            if key in values:
                raise self.fail(key_node, f"key '{key}' appears twice in {where}")
            values[key] = self._value(key, value_node, where)
            lines[key] = key_node
        for required in dataclasses.fields(kind):
            no_default = required.default is required.default_factory is dataclasses.MISSING
            if no_default and required.name not in values:
                raise self.fail(node, f"'{required.name}' is missing in {where}")
        try:
            return kind(**values)
        except (ValueError, TypeError) as error:
            guilty = next((lines[key] for key in lines if key in str(error)), node)
            raise self.fail(guilty, f"{where}: {error}") from None

    def _value(self, key: str, node: yaml.Node, where: str) -> Any:
        if key == "bus":
            return self._bus(node)
        if key not in _NESTED:
            return self._plain(node)
        if key not in _LISTS:
            return self.read(node, _NESTED[key], key)
        if not isinstance(node, yaml.SequenceNode):
            raise self.fail(node, f"'{key}' in {where} must be a list")
        return [self.read(item, _NESTED[key], f"{key}[{n}]") for n, item in enumerate(node.value)]

    def _bus(self, node: yaml.Node) -> dict[str, Any]:
        bus = self._plain(node)
        if not isinstance(bus, dict):
            raise self.fail(
                node, "'bus' must be a mapping with python-can's words, such as {interface: socketcan}"
            )
        return {str(key): value for key, value in bus.items()}

    def _plain(self, node: yaml.Node) -> Any:
        loader = yaml.SafeLoader("")
        try:
            return loader.construct_document(node)
        except yaml.YAMLError as error:
            raise self.fail(node, f"cannot be read: {error}") from None
        finally:
            loader.dispose()

    @staticmethod
    def _unknown(key: str, known: list[str], where: str) -> str:
        near = difflib.get_close_matches(key, known, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f"known are {', '.join(known)}"
        return f"unknown key '{key}' in {where}; {hint}"

    def check_distinct_nodes(self, root: yaml.Node, config: Config) -> None:
        """Two modules with one node id would answer each other's masters."""
        seen: dict[int, int] = {}
        items = next(value for key, value in root.value if key.value == "modules").value
        for n, module in enumerate(config.modules):
            if module.node_id in seen:
                raise self.fail(
                    items[n],
                    f"node_id {module.node_id} of modules[{n}] is that of modules[{seen[module.node_id]}]",
                )
            seen[module.node_id] = n
