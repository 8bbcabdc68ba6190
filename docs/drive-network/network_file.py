"""The network file: what each node is, what it holds and what it sends. Checked before the bus is touched.

Every message names the file, the line and the key::

    network.yaml:14: nodes[0]: unknown key 'node-id'; known: eds, expect, heartbeat_ms, ...

Objects are written as index:sub-index in hexadecimal (60E6:01, 6060) or by their names in the EDS
("Supervision.Residual limit"). Needs python canopen and pyyaml.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import canopen
import yaml
from canopen.objectdictionary import BOOLEAN, FLOAT_TYPES, INTEGER_TYPES, VISIBLE_STRING, ODVariable

MASTER = "master"
TPDO, RPDO = 0x1800, 0x1400
OFF, NO_REMOTE_FRAME = 1 << 31, 1 << 30
SYNC_TYPES = range(241)
TYPES = {TPDO: (*SYNC_TYPES, 252, 253, 254, 255), RPDO: (*SYNC_TYPES, 254, 255)}
IDENTITY = {
    "device_type": (0x1000, 0),
    "vendor_id": (0x1018, 1),
    "product_code": (0x1018, 2),
    "revision": (0x1018, 3),
    "serial_number": (0x1018, 4),
}
ELSEWHERE = {
    0x1005: "sync",
    0x1006: "sync",
    0x1010: "save",
    0x1011: "nothing: restore by hand",
    0x1016: "watches",
    0x1017: "heartbeat_ms",
}  # objects that have a key of their own


class NetworkFileError(Exception):
    """The file is wrong; one line with file, line and key."""


@dataclass(frozen=True)
class Pdo:
    """One PDO of a node: the communication object (14xxh, 18xxh) and the mapping object 200h above.

    ``cob_id`` None: off. ``mapping`` has the entries as the node keeps them, ``times`` sub-index -> value.
    """

    index: int
    cob_id: int | None = None
    kind: int = 0
    mapping: tuple[int, ...] = ()
    times: dict[int, int] = field(default_factory=dict)
    link: str = ""

    @property
    def mapping_index(self) -> int:
        """16xxh or 1Axxh."""
        return self.index + 0x200

    @property
    def is_tpdo(self) -> bool:
        """The node sends it."""
        return self.index >= TPDO

    @property
    def number(self) -> int:
        """1 for the first of its direction."""
        return (self.index & 0x1FF) + 1

    @property
    def cob_id_value(self) -> int:
        """What sub-index 1 holds, bit 31 aside."""
        return (self.cob_id or 0) | (NO_REMOTE_FRAME if self.is_tpdo else 0)


@dataclass
class Node:
    """One node of the file. ``expect``: (index, sub) -> value; ``parameters``: the same -> bytes."""

    name: str
    node_id: int
    od: Any
    expect: dict[tuple[int, int], int]
    heartbeat_ms: int = 0
    watches: dict[int, int] = field(default_factory=dict)
    parameters: dict[tuple[int, int], bytes] = field(default_factory=dict)
    pdos: dict[int, Pdo] = field(default_factory=dict)
    save: bool = False

    def __str__(self) -> str:
        return f"{self.name} ({self.node_id:02X}h)"


@dataclass
class NetworkFile:
    """A whole network. ``nodes`` stand in the order of ``start``.

    ``sync_waits_s`` is for how long a SYNC waits for the answers to the last one; 0.0: it does not.
    """

    bus: dict[str, Any]
    sync_period_us: int
    sync_waits_s: float
    master_id: int
    master_heartbeat_ms: int
    nodes: dict[str, Node]


@dataclass(frozen=True)
class Item:
    """A value of the file and where it stands: dict[str, Item], list[Item] or a plain value."""

    value: Any
    file: str
    line: int
    where: str
    written: str = ""  # a plain value as it stands there

    def error(self, text: str) -> NetworkFileError:
        """The error to raise about it."""
        return NetworkFileError(f"{self.file}:{self.line}: {self.where}: {' '.join(text.split())}")

    def mapping(self, required: str, optional: str = "") -> dict[str, Item]:
        """Its keys, checked against two lists of words."""
        known = [*required.split(), *optional.split()]
        items = self.keys()
        for key, item in items.items():
            if key not in known:
                at = Item(None, self.file, item.line, self.where)
                raise at.error(f"unknown key '{key}'; known: {', '.join(sorted(known))}")
        for key in required.split():
            if key not in items:
                raise self.error(f"'{key}' is missing")
        return items

    def keys(self) -> dict[str, Item]:
        """All its keys."""
        if not isinstance(self.value, dict):
            raise self.error("a mapping, key: value, is required here")
        return self.value

    def items(self) -> list[Item]:
        """Its list."""
        if not isinstance(self.value, list):
            raise self.error("a list is required here")
        return self.value

    def integer(self, low: int, high: int) -> int:
        """A whole number within limits."""
        if type(self.value) is not int or not low <= self.value <= high:
            raise self.error(f"a whole number {low} to {high} is required, not {self.plain()!r}")
        return self.value

    def text(self) -> str:
        """One word or a line of text."""
        if not isinstance(self.value, str) or not self.value:
            raise self.error(f"a word is required, not {self.plain()!r}")
        return self.value

    def flag(self) -> bool:
        """True or false."""
        if not isinstance(self.value, bool):
            raise self.error(f"true or false is required, not {self.plain()!r}")
        return self.value

    def plain(self) -> Any:
        """The value without the places."""
        if isinstance(self.value, dict):
            return {key: item.plain() for key, item in self.value.items()}
        return [item.plain() for item in self.value] if isinstance(self.value, list) else self.value


class _Loader(yaml.SafeLoader):
    """Plain numbers only: in YAML 1.1, 2011:01 would be a number of base 60 and 0006 an octal one."""

    yaml_implicit_resolvers = {}  # noqa: RUF012 (as in the base class)

    def compose_node(self, parent: Any, index: Any) -> Any:
        """As in the base class, but no alias: one may stand for a part that holds itself."""
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(None, None, "write it out instead of an alias", mark)
        return super().compose_node(parent, index)


for _tag, _pattern, _first in (
    ("bool", r"true|false", "tf"),
    ("int", r"[-+]?(0|[1-9][0-9]*)|0x[0-9A-Fa-f]+", "-+0123456789"),
    ("float", r"[-+]?[0-9]+(\.[0-9]*)?([eE][-+]?[0-9]+)?", "-+0123456789"),
):
    _Loader.add_implicit_resolver(f"tag:yaml.org,2002:{_tag}", re.compile(f"(?:{_pattern})$"), list(_first))


def load(path: str | Path) -> NetworkFile:
    """Read and check the file and the EDS files that it names; NetworkFileError for a bad one."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise NetworkFileError(f"{path}: cannot be read: {error}") from None
    return _Reader(path.parent).network(_parse(text, str(path)))


def _parse(text: str, name: str) -> Item:
    try:
        loader = _Loader(text)
    except yaml.reader.ReaderError as error:
        raise Item(None, name, 1, "no YAML").error(str(error.reason)) from None
    try:
        root = loader.get_single_node()
        return _item(loader, root, name, "the network") if root else Item({}, name, 1, "the network")
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise Item(None, name, mark.line + 1 if mark else 1, "no YAML").error(str(error.problem)) from None
    except RecursionError:
        raise Item(None, name, 1, "no network").error("nested too deeply") from None
    finally:
        loader.dispose()


def _item(loader: Any, node: Any, name: str, where: str) -> Item:
    inside = "" if where == "the network" else f"{where}."
    line = node.start_mark.line + 1
    if isinstance(node, yaml.ScalarNode):
        try:
            return Item(loader.construct_object(node), name, line, where, node.value)
        except (ValueError, yaml.YAMLError) as error:
            raise Item(None, name, line, where).error(f"cannot be read: {error}") from None
    if isinstance(node, yaml.SequenceNode):
        children = [_item(loader, child, name, f"{where}[{n}]") for n, child in enumerate(node.value)]
        return Item(children, name, line, where)
    items: dict[str, Item] = {}
    for key, child in node.value:
        if not isinstance(key, yaml.ScalarNode):
            raise Item(None, name, key.start_mark.line + 1, where).error("a key must be one word")
        item = _item(loader, child, name, f"{inside}{key.value}")
        if key.value in items:
            raise item.error("this key appears twice")
        items[key.value] = item
    return Item(items, name, line, where)


def find_object(od: Any, word: str) -> Any:
    """The variable of an EDS for 6040, 60E6:01 or a name; None when there is none."""
    number = re.fullmatch(r"(?:0x)?([0-9A-Fa-f]{4})h?(?::(?:0x)?([0-9A-Fa-f]{1,2}))?", word)
    try:
        found = od[word if number is None else int(number[1], 16)]
        if number is not None and not isinstance(found, ODVariable):
            found = found.subindices[int(number[2] or "0", 16)]
        elif number is not None and int(number[2] or "0", 16):
            return None
    except KeyError:
        return None
    return found if isinstance(found, ODVariable) else None


class _Reader:
    """Turns items into a network, step by step."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._nodes: dict[str, Node] = {}
        self._cob_ids: dict[int, str] = {}

    def network(self, root: Item) -> NetworkFile:
        keys = root.mapping("bus sync_period_us nodes links start", "sync_waits_ms eds_folder master")
        master = keys["master"].mapping("node_id", "heartbeat_ms") if "master" in keys else {}
        folder = self._folder / (keys["eds_folder"].text() if "eds_folder" in keys else ".")
        for item in keys["nodes"].items():
            node = self._node(item, folder)
            self._nodes[node.name] = node
        master_id = master["node_id"].integer(1, 127) if master else 127
        self._distinct(keys["nodes"].items(), master_id)
        for item in keys["nodes"].items():
            self._watches(item.value, master_id)
        for item in keys["links"].items():
            self._link(item)
        for node in self._nodes.values():
            for index in node.od:
                if (RPDO <= index < RPDO + 0x200 or TPDO <= index < TPDO + 0x200) and index not in node.pdos:
                    node.pdos[index] = Pdo(index)
        return NetworkFile(
            keys["bus"].plain() if keys["bus"].keys() else {},
            keys["sync_period_us"].integer(100, 10_000_000),
            keys["sync_waits_ms"].integer(0, 60_000) / 1000 if "sync_waits_ms" in keys else 0.0,
            master_id,
            master["heartbeat_ms"].integer(0, 65535) if "heartbeat_ms" in master else 0,
            {node.name: node for node in self._start(keys["start"])},
        )

    def _node(self, item: Item, folder: Path) -> Node:
        keys = item.mapping("name node_id eds expect", "heartbeat_ms watches parameters save")
        name, node_id = keys["name"].text(), keys["node_id"].integer(1, 127)
        if name in self._nodes or name == MASTER:
            raise keys["name"].error(f"the name {name!r} is taken")
        path = folder / keys["eds"].text()
        try:
            od = canopen.import_od(str(path), node_id)
        except OSError as error:
            raise keys["eds"].error(f"{path} cannot be read: {error.strerror}") from None
        except Exception as error:  # canopen's reader raises many kinds
            raise keys["eds"].error(f"{path} is not an EDS file: {error}") from None
        expect = keys["expect"].mapping("device_type", " ".join(IDENTITY))
        node = Node(
            name, node_id, od, {IDENTITY[key]: value.integer(0, 2**32 - 1) for key, value in expect.items()}
        )
        if "heartbeat_ms" in keys:
            node.heartbeat_ms = keys["heartbeat_ms"].integer(0, 65535)
        if "save" in keys:
            node.save = keys["save"].flag()
        for word, value in keys["parameters"].keys().items() if "parameters" in keys else ():
            variable = self._parameter(node, word, value)
            node.parameters[variable.index, variable.subindex] = _encoded(variable, value)
        return node

    def _parameter(self, node: Node, word: str, value: Item) -> Any:
        variable = find_object(node.od, word)
        if variable is None:
            raise value.error(f"the EDS of {node.name} has no such object")
        index = variable.index
        if 0x1400 <= index < 0x1C00 or index in ELSEWHERE:
            raise value.error(f"{index:04X}h is set by the key '{ELSEWHERE.get(index, 'links')}'")
        if "w" not in variable.access_type:
            raise value.error(f"{index:04X}h is read only ({variable.access_type})")
        if (index, variable.subindex) in node.parameters:
            raise value.error(f"{index:04X}:{variable.subindex:02X} is set twice")
        return variable

    def _distinct(self, items: list[Item], master_id: int) -> None:
        taken = {master_id: MASTER}
        for item in items:
            node_id, name = item.value["node_id"], item.value["name"].value
            if node_id.value in taken:
                raise node_id.error(f"node-ID {node_id.value} is also that of {taken[node_id.value]}")
            taken[node_id.value] = name

    def _watches(self, keys: dict[str, Item], master_id: int) -> None:
        node = self._nodes[keys["name"].value]
        for name, item in keys["watches"].keys().items() if "watches" in keys else ():
            if name != MASTER and name not in self._nodes:
                raise item.error(f"there is no node {name!r}")
            watched = master_id if name == MASTER else self._nodes[name].node_id
            node.watches[watched] = item.integer(1, 65535)
            if len(node.watches) > len(node.od[0x1016]) - 1 if 0x1016 in node.od else True:
                raise item.error("the EDS has no entry of 1016h left for it")

    def _link(self, item: Item) -> None:
        keys = item.mapping("name cob_id from", "to")
        cob_id, name = keys["cob_id"].integer(0x181, 0x57F), keys["name"].text()
        if cob_id in self._cob_ids:
            raise keys["cob_id"].error(f"{cob_id:03X}h is also that of {self._cob_ids[cob_id]!r}")
        self._cob_ids[cob_id] = name
        sent = 0
        if keys["from"].value != MASTER:
            sent = self._end(keys["from"], TPDO, cob_id, name)
        for end in keys["to"].items() if "to" in keys else ():
            if end.value == MASTER:
                continue
            taken = self._end(end, RPDO, cob_id, name)
            if sent and taken != sent:
                raise end.error(f"takes {taken} bits, {sent} are sent")

    def _end(self, item: Item, base: int, cob_id: int, link: str) -> int:
        """One end of a link; the bits of its mapping."""
        word = "tpdo" if base == TPDO else "rpdo"
        keys = item.mapping(
            f"node {word} type map", "inhibit_100us event_timer_ms" if base == TPDO else "timeout_ms"
        )
        node = self._nodes.get(keys["node"].text())
        if node is None:
            raise keys["node"].error(f"there is no node {keys['node'].value!r}")
        index = base + keys[word].integer(1, 512) - 1
        if index not in node.od or index in node.pdos:
            why = "has it in another link" if index in node.pdos else "has none in its EDS"
            raise keys[word].error(f"{node.name} {why}: {index:04X}h")
        kind = keys["type"].integer(0, 255)
        if kind not in TYPES[base]:
            raise keys["type"].error(f"{kind} is not a transmission type of a {word.upper()}")
        mapping = tuple(_mapped(node, entry, base) for entry in keys["map"].items())
        bits = sum(entry & 0xFF for entry in mapping)
        if not 0 < bits <= 64:
            raise keys["map"].error(f"{bits} bits are mapped; must be 1 to 64")
        if len(mapping) >= len(node.od[index + 0x200]):
            raise keys["map"].error(f"{node.name} maps {len(node.od[index + 0x200]) - 1} objects at most")
        places = {"inhibit_100us": 3, "event_timer_ms": 5, "timeout_ms": 5}
        times = {places[key]: keys[key].integer(0, 65535) for key in places if key in keys}
        for subindex in set(times) - set(node.od[index].subindices):
            raise item.error(f"{node.name} has no {index:04X}:{subindex:02X}")
        node.pdos[index] = Pdo(index, cob_id, kind, mapping, times, link)
        return bits

    def _start(self, item: Item) -> list[Node]:
        names = [name.text() for name in item.items()]
        if sorted(names) != sorted(self._nodes):
            raise item.error(f"must list each node once: {', '.join(self._nodes)}")
        return [self._nodes[name] for name in names]


def _mapped(node: Node, item: Item, base: int) -> int:
    """The entry of a mapping: index, sub-index, bits."""
    variable = find_object(node.od, item.written)
    if variable is None:
        raise item.error(f"the EDS of {node.name} has no {item.written}")
    dummy = variable.index < 0x20
    if not dummy and not variable.pdo_mappable:
        raise item.error(f"{item.written} of {node.name} cannot be mapped")
    wrong = {TPDO: ("wo", "rww", "const"), RPDO: ("ro", "rwr")}[base]  # CiA 306; a dummy is const
    if variable.access_type in wrong or (base == RPDO and not dummy and variable.access_type == "const"):
        raise item.error(f"{item.written} of {node.name} cannot be mapped in this direction")
    return int(variable.index << 16 | variable.subindex << 8 | len(variable))


def _encoded(variable: Any, item: Item) -> bytes:
    """A value as the node keeps it."""
    value, kind = item.value, variable.data_type
    fits: dict[int, tuple[type, ...]] = {VISIBLE_STRING: (str,), BOOLEAN: (bool,)}
    fits |= dict.fromkeys(INTEGER_TYPES, (int,)) | dict.fromkeys(FLOAT_TYPES, (int, float))
    if type(value) not in fits.get(kind, ()):
        raise item.error(f"{value!r} does not fit the data type {kind:04X}h of {variable.name}")
    low, high = variable.min, variable.max
    if (low is not None and value < low) or (high is not None and value > high):
        raise item.error(f"{variable.name} is {low} to {high}, not {value!r}")
    try:
        return bytes(variable.encode_raw(value))
    except (ValueError, TypeError, OverflowError) as error:
        raise item.error(f"{value!r} does not fit {variable.name}: {error}") from None
