"""``canfb config dcf``: the configuration of a module as a file that a CANopen master loads."""

from __future__ import annotations

import argparse
import json
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from canfb.bus.master import BusMaster
from canfb.bus.opening import open_bus
from canfb.bus.saved_parameters import SavedParameters
from canfb.bus.wall_clock import file_date_and_time
from canfb.cli.options import (
    add_bus_options,
    bus_options,
    chosen_module,
    refuse_idle,
    whole_number,
)
from canfb.cli.printing import report
from canfb.commissioning.access import Master, NodeAccess, ObjectAbsentError
from canfb.configuration import Config, load_config
from canfb.device import datatypes
from canfb.device.concise import encode_concise
from canfb.device.dcf import Commissioning, FileInfo, Place, Reals, dcf_text
from canfb.device.dictionary import Dictionary
from canfb.device.entry import Entry
from canfb.device.lss import UNCONFIGURED
from canfb.eds_files import eds_path
from canfb.errors import CanfbError, ConfigError
from canfb.module.config import ModuleConfig
from canfb.module.device_configuration import DeviceConfiguration, configuration_of, configuration_read
from canfb.module.feedback_module import EDS, FeedbackModule
from canfb.module.table_store import ACTIVE_CRC, STAGED, TABLE

INLINE, FILE = "inline", "file"
IDENTITY = ((0x1000, 0), (0x1018, 1), (0x1018, 2))  # what a module is known by


def add_options(parser: argparse.ArgumentParser) -> None:
    """All options of the command."""
    parser.add_argument(
        "config", metavar="CONFIG.yaml", nargs="?", help="the module that it configures, without a bus"
    )
    parser.add_argument(
        "--module",
        type=whole_number,
        metavar="ID",
        help="node id of the module, where there are several",
    )
    parser.add_argument("--node", type=whole_number, metavar="ID", help="read this node on the bus instead")
    parser.add_argument("--out", type=Path, metavar="FILE", help="the DCF (module-20h.dcf); replaced")
    parser.add_argument("--concise", type=Path, metavar="FILE", help="the concise form, for object 1F22h")
    parser.add_argument(
        "--table",
        choices=(INLINE, FILE),
        default=INLINE,
        help="the correction table: in the DCF and in a file (default), or in the file alone",
    )
    parser.add_argument(
        "--reals",
        choices=[reals.value for reals in Reals],
        default=Reals.DECIMAL.value,
        help="numbers of type REAL32: decimal (default), or their bits, as lely's tools read them",
    )
    parser.add_argument("--name", default="", help="NodeName of the DCF (module_20h)")
    parser.add_argument("--json", action="store_true", help="the summary, for programs")
    parser.add_argument(
        "--answer-within", type=float, default=1.0, metavar="S", help="time for an SDO answer (1)"
    )
    add_bus_options(parser)


def write_dcf(options: argparse.Namespace) -> int:
    """Write the files; 0 when it is done."""
    _check(options)
    config = load_config(options.config) if options.config else Config()
    words = bus_options(options, config.bus)
    if options.node is None:
        configuration = configured(_chosen(config, options))
    else:
        with BusMaster(open_bus(words), options.answer_within) as master:
            configuration = read_node(master, options.node)
    return _Files(options, configuration, words).write()


def configured(config: ModuleConfig) -> DeviceConfiguration:
    """The module as it comes up: its configuration, and over it what is saved in its state_dir.

    ConfigError when it has no node-ID, CanfbError when what is saved is refused.
    """
    store = None if config.state_dir is None else SavedParameters(config.state_dir)
    module = FeedbackModule(config, store, source=None if config.source is None else _NoSource())
    module.start(0.0)
    if module.node.node_id == UNCONFIGURED:
        raise ConfigError(
            f"the module with serial number {config.serial_number} has no node-ID yet, and a DCF is for one: "
            "give it a node_id in the configuration, or by LSS"
        )
    for group, why in module.node.storage.faults.items():
        raise CanfbError(f"stored {group.name.lower()} parameters in {config.state_dir} refused: {why}")
    return configuration_of(module)


def read_node(master: Master, node_id: int) -> DeviceConfiguration:
    """The configuration of a module on a bus. CommissioningError for what does not work."""
    node = NodeAccess(master, node_id, "node")
    dictionary = Dictionary.load(eds_path(EDS), node_id)
    for place in IDENTITY:
        entry = dictionary.entry(*place)
        found = _read(node, entry)
        if found != entry.value:
            what = f"{place[0]:04X}:{place[1]:02X} is {found:X}h, not {entry.value:X}h"
            raise CanfbError(f"{node.name} is no feedback module of canfb: {what}")
    serial_number = int(_read(node, dictionary.entry(0x1018, 4)))
    table = _read_table(node, dictionary)
    return configuration_read(node_id, lambda entry: _read(node, entry), serial_number, table)


class _NoSource:
    """In place of a source that nobody asks."""

    def next(self) -> None:
        """No sample."""


def _read(node: NodeAccess, entry: Entry) -> Any:
    letter = datatypes.FORMATS.get(entry.data_type)
    try:
        if letter is None:
            return entry.decode(node.upload_domain(entry.index, entry.subindex))
        return node.read(entry.index, entry.subindex, letter)
    except ObjectAbsentError as error:
        raise CanfbError(f"{error}: another version of canfb has made this module") from None


def _read_table(node: NodeAccess, dictionary: Dictionary) -> bytes:
    """The active table, empty for the identity."""
    crc32 = _read(node, dictionary.entry(TABLE, ACTIVE_CRC))
    if not crc32:
        return b""
    table = node.upload_domain(TABLE, STAGED)
    if zlib.crc32(table) != crc32:
        raise CanfbError(f"{node.name}: the table changed while it was read; try again")
    return table


@dataclass
class _Files:
    """What is written, and what is said of it."""

    options: argparse.Namespace
    configuration: DeviceConfiguration
    words: dict[str, Any]

    def write(self) -> int:
        """All files."""
        node_id = self.configuration.node_id
        path: Path = self.options.out or Path(f"module-{node_id:02X}h.dcf")
        table_path = path.with_suffix(".table.bin") if self.configuration.table else None
        _put(path, self._text(path, table_path).encode("ascii", errors="replace"))
        if table_path is not None:
            _put(table_path, self.configuration.table)
        concise = encode_concise(self.configuration.writes())
        if self.options.concise is not None:
            _put(self.options.concise, concise)
        refused = self.configuration.refused_in_index_order()
        if self.options.json:
            print(json.dumps(self._summary(path, table_path, refused), indent=2))
            return 0
        for line in self._lines(path, table_path):
            print(line)
        if refused:
            report(
                f"note: a master that writes each object once, in the order of the indices, is refused at "
                f"{_places(refused)}; give it the concise form (--concise)"
            )
        return 0

    def _text(self, path: Path, table_path: Path | None) -> str:
        options, configuration = self.options, self.configuration
        date, time = file_date_and_time()
        bit_rate, channel = self.words.get("bitrate"), self.words.get("channel")
        return dcf_text(
            eds_path(EDS),
            FileInfo(
                file_name=path.name,
                description=f"Configuration of a drive feedback module, node-ID {configuration.node_id}",
                date=date,
                time=time,
            ),
            Commissioning(
                node_id=configuration.node_id,
                node_name=options.name or f"module_{configuration.node_id:02X}h",
                bit_rate_kbit_s=round(bit_rate / 1000) if isinstance(bit_rate, int) else None,
                network_name="CANopen" if channel is None else str(channel),
                serial_number=configuration.serial_number,
            ),
            configuration.values(with_table=options.table == INLINE),
            reals=Reals(options.reals),
            files=None if table_path is None else {(TABLE, STAGED): table_path.name},
        )

    def _summary(self, path: Path, table_path: Path | None, refused: list[Place]) -> dict[str, Any]:
        configuration, concise = self.configuration, self.options.concise
        return {
            "dcf": str(path),
            "concise": None if concise is None else str(concise),
            "table": None if table_path is None else str(table_path),
            "node_id": configuration.node_id,
            "serial_number": configuration.serial_number,
            "parameters": len(configuration.settings),
            "changed": {_place(place): value for place, value in configuration.changed().items()},
            "table_crc32": f"{configuration.table_crc32:08X}",
            "table_entries": len(configuration.table) // 4,
            "concise_writes": len(configuration.writes()),
            "refused_in_index_order": [_place(place) for place in refused],
        }

    def _lines(self, path: Path, table_path: Path | None) -> list[str]:
        configuration, concise = self.configuration, self.options.concise
        node_id, changed = configuration.node_id, configuration.changed()
        others = f"; not as delivered: {_places(list(changed))}" if changed else ", all as delivered"
        lines = [f"{path}: node {node_id} ({node_id:02X}h), {len(configuration.settings)} parameters{others}"]
        if table_path is not None:
            size = len(configuration.table) // 4
            lines.append(f"{table_path}: correction table, {size} entries, {configuration.table_crc32:08X}")
        if concise is not None:
            lines.append(f"{concise}: the concise form, {len(configuration.writes())} writes")
        return lines


def _check(options: argparse.Namespace) -> None:
    """ConfigError for options that cannot be, alone or together."""
    if options.node is None and options.config is None:
        raise ConfigError("CONFIG.yaml or --node ID is wanted: a module of a configuration, or one on a bus")
    if options.node is not None and options.module is not None:
        raise ConfigError("--module: only without --node, which names the module")
    if options.node is not None and not 1 <= options.node <= 127:
        raise ConfigError(f"--node {options.node}: must be 1 to 127")
    if options.node is None:
        refuse_idle(options, ["answer_within"], "only with --node, which is asked over the bus")
    if not 0.01 <= options.answer_within <= 60.0:
        raise ConfigError(f"--answer-within {options.answer_within:g}: must be 0.01 to 60")
    if not options.name.isascii() or not options.name.isprintable() or ";" in options.name:
        raise ConfigError(f"--name {options.name!r}: letters, digits and signs of ASCII, without ;")
    if options.out is not None and options.out == options.concise:
        raise ConfigError(f"--concise {options.concise}: must be another file than --out")


def _chosen(config: Config, options: argparse.Namespace) -> ModuleConfig:
    """The module of the configuration. ConfigError when it is not clear which."""
    if options.module is None and len(config.modules) > 1:
        there = ", ".join(f"{module.node_id} ({module.node_id:02X}h)" for module in config.modules)
        raise ConfigError(f"{options.config}: --module ID is required, as there are several: {there}")
    try:
        return chosen_module(options, config)
    except ConfigError as error:
        raise ConfigError(f"{options.config}: {error}") from None


def _put(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except OSError as error:
        raise CanfbError(f"cannot write {path}: {error.strerror}") from None


def _place(place: Place) -> str:
    return f"{place[0]:04X}:{place[1]:02X}"


def _places(places: list[Place]) -> str:
    return ", ".join(_place(place) for place in places)
