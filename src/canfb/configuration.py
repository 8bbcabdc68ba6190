"""The YAML of the commands: its keys are the fields of the classes.

Every message names the file, the line and the key::

    feedback.yaml:4: unknown key 'adc_bit' in modules[0]; did you mean 'adc_bits'?
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from canfb.checks import within
from canfb.errors import LONGEST_REASON, ConfigError, meant
from canfb.files import read_bytes
from canfb.interface.encoder_interface import InterfaceConfig
from canfb.marked_yaml import YamlError, compose, construct, found_at, line_of as yaml_line, pairs
from canfb.module.module_config import UNCONFIGURED, ModuleConfig, SecondPositionConfig
from canfb.signal.adaptation import AdaptConfig
from canfb.signal.conditioning import Conditioning
from canfb.sources.protocol import SourceConfig, source_kinds

if TYPE_CHECKING:
    from canfb.simulation.scenario import SimulationConfig

MODULES, INTERFACES = ("modules",), ("interfaces",)
ANY_NODES = MODULES + INTERFACES  # The lists of nodes; a command needs one of several.
_NODES = {"modules": "module", "interfaces": "encoder interface"}
NodeConfig = ModuleConfig | InterfaceConfig


@dataclass(frozen=True, kw_only=True)
class RealtimeConfig:
    """Real-time options of the process.

    priority      of SCHED_FIFO, 0..99; 0: the default scheduler
    lock_memory   True: no page of the process is swapped out
    cpu           the only processor used, 0..65535; None: any
    busy_poll     True: never sleep; requires ``cpu`` and uses all of it. Not with ``priority``: by default
                  the kernel halts a program of SCHED_FIFO for 5 % of the time (sched(7))
    """

    priority: int = 0
    lock_memory: bool = False
    cpu: int | None = None
    busy_poll: bool = False

    def __post_init__(self) -> None:
        within(self, priority=(0, 99), cpu=(0, 65535), lock_memory=bool, busy_poll=bool)
        if self.busy_poll and self.cpu is None:
            raise ValueError("busy_poll needs a processor of its own: set cpu, for example cpu: 3")
        if self.busy_poll and self.priority:
            raise ValueError(
                "busy_poll: omit priority; the kernel halts a program with priority that never sleeps, for 5 "
                "% of the time. Keep other programs off the processor instead (isolcpus)"
            )


@dataclass(frozen=True)
class Config:
    """A configuration, validated.

    bus          python-can's own words (interface, channel, bitrate, ...), may be empty
    modules      the drive feedback modules, all in one process
    interfaces   the encoder interfaces with a source, served by ``canfb run``
    realtime     real-time options
    played       the ``simulation`` section; None: none
    """

    bus: dict[str, Any] = field(default_factory=dict)
    modules: list[ModuleConfig] = field(default_factory=list)
    interfaces: list[InterfaceConfig] = field(default_factory=list)
    realtime: RealtimeConfig = field(default_factory=RealtimeConfig)
    played: SimulationConfig | None = field(default=None, metadata={"named": "simulation"})

    @property
    def simulation(self) -> SimulationConfig:
        """The ``simulation`` section, or its defaults."""
        from canfb.simulation.scenario import SimulationConfig  # here: canfb run needs no simulation

        return self.played or SimulationConfig()

    @property
    def lists(self) -> dict[str, Sequence[NodeConfig]]:
        """The lists of nodes, by key."""
        return {"modules": self.modules, "interfaces": self.interfaces}

    @property
    def nodes(self) -> list[tuple[str, int, NodeConfig]]:
        """Key, index in the list, and configuration of each module and interface."""
        return [(key, n, one) for key, those in self.lists.items() for n, one in enumerate(those)]

    @property
    def node_ids(self) -> list[int]:
        """Of all nodes with one, and of the interfaces that send the modules their samples."""
        known = [one.node_id for _, _, one in self.nodes]
        known += [one.encoder_interface for one in self.modules if one.source is None]
        return sorted({node for node in known if 1 <= node <= 127})


# What a key holds: a class, a list of one, python-can's words, a source by its kind. Others: a single value.
_HOLDS: dict[str, Any] = {
    "bus": dict,
    "modules": [ModuleConfig],
    "interfaces": [InterfaceConfig],
    "realtime": RealtimeConfig,
    "conditioning": Conditioning,
    "adapt": AdaptConfig,  # or true for its defaults, or false
    "second_position": SecondPositionConfig,
    "source": SourceConfig,
}
_TAG = "tag:yaml.org,2002:"


def load_config(path: str | Path, needs: Sequence[str] = MODULES) -> Config:
    """Read and validate the configuration at ``path``; one of the lists ``needs`` must not be empty.

    ConfigError, in one line with file, line and key.
    """
    path = Path(path)
    data = read_bytes(path, ConfigError)
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise _config_error(str(path), line, "this is not UTF-8 text") from None
    return parse_config(text, str(path), needs)


def parse_config(text: str, name: str = "configuration", needs: Sequence[str] = MODULES) -> Config:
    """:func:`load_config` for a text; ``name`` stands in the messages for the file."""
    root = _compose(text, name)
    if root is None:
        raise _config_error(name, 1, "the configuration is empty; 'canfb config example' prints one")
    config: Config = _Reader(name).read(root, Config, "the configuration")
    if not any(getattr(config, one) for one in needs):
        lists, words = " or ".join(map(repr, needs)), " or ".join(_NODES[one] for one in needs)
        raise _config_error(name, 1, f"{lists} is missing: a list with at least one {words}")
    _check_distinct_nodes(name, root, config)
    return config


def changed_module(module: ModuleConfig, settings: Sequence[str]) -> ModuleConfig:
    """The module with other values, KEY=VALUE as in YAML, not ``source``. ConfigError."""
    known = {one.name: one for one in fields(ModuleConfig) if one.name != "source"}
    values: dict[str, Any] = {}
    for setting in settings:
        key, equals, text = setting.partition("=")
        if not equals or key not in known:
            why = _unknown(key, list(known), "a module") if equals else "write it as KEY=VALUE"
            raise ConfigError(_short(f"--set {setting}: {why}"))
        name = f"--set {key}"
        node = _compose(text, name)
        values[key] = node and _Reader(name).value(key, node, "a module", known[key])
    try:
        return replace(module, **values)
    except (ValueError, TypeError) as error:
        raise ConfigError(_short(f"--set: {error}")) from None


def line_of(path: str | Path, *keys: str | int, said: str = "") -> int:
    """The line of a key, ``"modules", 0, "source"``, in a configuration that :func:`load_config` has read.

    Of the last of these keys that is there; in a mapping, of the key of which ``said`` speaks.
    """
    line, node = found_at(_compose(Path(path).read_text(encoding="utf-8"), str(path)), *keys)
    lines = {name.value: yaml_line(name) for name, _ in pairs(node)}
    return next((lines[word] for word in re.findall(r"\w+", said) if word in lines), line)


def _compose(text: str, name: str) -> yaml.Node | None:
    try:
        return compose(text, exponents=True)
    except YamlError as error:
        raise _config_error(name, error.line, error.said) from None


def _config_error(name: str, line: int, text: str) -> ConfigError:
    return ConfigError(f"{name}:{line}: {_short(text)}")


def _short(text: str) -> str:
    short = " ".join(text.split())
    return f"{short[:LONGEST_REASON]} ..." if len(short) > LONGEST_REASON else short


# Keys of older versions, and merge keys of YAML: what to do.
GONE = dict.fromkeys(
    ("prediction_order", "max_jerk_rad_s3"),
    "leave it out; a servo takes several samples for each SYNC (samples_per_sync)",
) | {"<<": "merge keys are not read; an alias (*name) can only be a whole value"}


def _unknown(key: str, known: list[str], where: str) -> str:
    if key in GONE:
        return f"{key!r} in {where} is not a key: {GONE[key]}"
    return f"unknown key {key!r} in {where}; {meant(key, known)}"


class _Reader:
    """Turns YAML nodes into dataclasses; what is wrong has the line of its key."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._holds = dict(_HOLDS)

    def _fail(self, node: yaml.Node, text: str) -> ConfigError:
        return _config_error(self._name, yaml_line(node), text)

    def _inside(self, node: yaml.Node, kind: type[yaml.CollectionNode], where: str, must: str) -> Any:
        if not isinstance(node, kind):
            raise self._fail(node, f"{where} must be {must}")
        if node.tag not in (f"{_TAG}map", f"{_TAG}seq"):
            raise self._fail(node, f"{where} has the tag {node.tag!r}; a configuration needs none")
        return node.value

    def read(self, node: yaml.Node, kind: type, where: str) -> Any:
        inside = self._inside(node, yaml.MappingNode, where, "a mapping of keys to values")
        known = {f.metadata.get("named", f.name): f for f in fields(kind) if f.metadata.get("key", True)}
        values: dict[str, Any] = {}
        lines: dict[str, yaml.Node] = {}
        for key_node, value_node in inside:
            key = key_node.value
            if key not in known:
                raise self._fail(key_node, _unknown(key, list(known), where))
            values[known[key].name] = self.value(key, value_node, where, known[key])
            lines[key] = key_node
        for one in known.values():
            if one.default is one.default_factory is MISSING and one.name not in values:
                raise self._fail(node, f"'{one.name}' is missing in {where}")
        try:
            if isinstance(source := values.get("source"), SourceConfig):
                values["source"] = source.of_module(values)
            return kind(**values)
        except (ValueError, TypeError) as error:
            # The first key that it names; sine_gain is not cosine_gain.
            guilty = (lines[word] for word in re.findall(r"\w+", str(error)) if word in lines)
            raise self._fail(next(guilty, node), f"{where}: {error}") from None

    def value(self, key: str, node: yaml.Node, where: str, into: Field[Any]) -> Any:
        what = f"'{key}' in {where}"
        if key == "simulation":
            from canfb.simulation.scenario import SECTION  # here: a file without it loads no simulation

            self._holds |= SECTION
        kind = self._holds.get(key)
        if kind is dict:
            must = "a mapping of python-can's parameters, such as {interface: socketcan}"
            words = self._inside(node, yaml.MappingNode, "'bus'", must)
            return {name.value: self._plain(value, f"{name.value!r} in bus") for name, value in words}
        if isinstance(kind, list):
            items = self._inside(node, yaml.SequenceNode, what, "a list")
            return [self.read(item, kind[0], f"{key}[{n}]") for n, item in enumerate(items)]
        if into.metadata.get("list", False) and isinstance(node, yaml.SequenceNode):
            items = self._inside(node, yaml.SequenceNode, what, "a list")
            return [self._single(item, f"a part of {what}") for item in items]
        if into.default is None and node.tag == f"{_TAG}null":
            return None
        if kind is SourceConfig:
            return self.read(node, self._kind_of_source(node), key)
        if kind is None or (kind is AdaptConfig and isinstance(node, yaml.ScalarNode)):
            return self._single(node, what)
        return self.read(node, kind, key)

    def _kind_of_source(self, node: yaml.Node) -> type[SourceConfig]:
        must = "a mapping with a kind, such as {kind: iio, device: ads7950}"
        inside, known = self._inside(node, yaml.MappingNode, "'source'", must), source_kinds()
        for key, value in inside:
            if key.value == "kind":
                kind = value.value if isinstance(value, yaml.ScalarNode) else None
                if kind not in known:
                    raise self._fail(value, f"unknown kind {kind!r} of source; known: {', '.join(known)}")
                return known[kind]
        raise self._fail(node, f"'kind' is missing in source; known: {', '.join(known)}")

    def _single(self, node: yaml.Node, what: str) -> Any:
        if not isinstance(node, yaml.ScalarNode):
            raise self._fail(node, f"{what} must be a single value")
        return self._plain(node, what)

    def _plain(self, node: yaml.Node, what: str) -> Any:
        try:
            return construct(node)
        except YamlError as error:
            raise self._fail(node, f"{what} cannot be read: {error.said}") from None


def _check_distinct_nodes(name: str, root: yaml.Node, config: Config) -> None:
    """Node-IDs, state folders, and serial numbers where a node-ID is missing, differ; a module sends no ADC
    counts."""
    devices = [
        (f"{key}[{n}]", one, yaml_line(found_at(root, key, n)[1] or root)) for key, n, one in config.nodes
    ]
    sampled = {
        title: one.encoder_interface
        for title, one, _ in devices
        if isinstance(one, ModuleConfig) and one.source is None
    }
    for (title, mine, line), (other, theirs, _) in itertools.permutations(devices, 2):
        if sampled.get(title) != theirs.node_id:
            continue
        if isinstance(theirs, ModuleConfig):
            said = f"encoder_interface {theirs.node_id} of {title} is the node_id of {other}"
            raise _config_error(name, line, said)
        asked, sent = ((one.times, one.samples_per_sync) for one in (mine, theirs))
        if asked != sent and (mine.times or mine.samples_per_sync not in (1, theirs.samples_per_sync)):
            said = f"times and samples_per_sync of {title} are not those of {other}, its interface"
            raise _config_error(name, line, said)
    for (other, theirs, _), (title, mine, line) in itertools.combinations(devices, 2):
        both = f"of {title} is also that of {other}"
        folders = [Path(folder).absolute() for folder in (mine.state_dir, theirs.state_dir) if folder]
        alike = type(mine) is type(theirs) and mine.serial_number == theirs.serial_number
        unnamed = UNCONFIGURED in (mine.node_id, theirs.node_id)
        for holds, said in (
            (mine.node_id == theirs.node_id != UNCONFIGURED, f"node_id {mine.node_id} {both}"),
            (len(folders) > len(set(folders)), f"state_dir {both}"),
            (alike and unnamed, f"serial_number {mine.serial_number} {both}: LSS needs unique ones"),
        ):
            if holds:
                raise _config_error(name, line, said)
    if config.played is not None and config.played.drive is not None:
        taken = {one.node_id: f"node_id of {title}" for title, one, _ in devices}
        taken |= {node_id: f"encoder_interface of {title}" for title, node_id in sampled.items()}
        drive = config.played.drive.node_id
        if drive in taken:
            line, _ = found_at(root, "simulation", "drive", "node_id")
            raise _config_error(name, line, f"drive: node_id {drive} is the {taken[drive]}")
