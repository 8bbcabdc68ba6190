"""The files that a CANopen master loads: DCF, concise form, correction table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from canfb import objects as od
from canfb.device.od.dcf import Commissioning, FileInfo, Place, Reals, dcf_text
from canfb.device.od.writes import encode_concise
from canfb.eds_files import eds_path
from canfb.errors import CanfbError
from canfb.module.device_configuration import DeviceConfiguration
from canfb.module.parameters import EDS


@dataclass(frozen=True)
class ConfigurationFiles:
    """Where a configuration is written to, and how.

    out            the DCF; None: module-20h.dcf, with the node-ID of the module
    concise        the concise form (1F22h), None: not written
    table_inline   the table is in the DCF, too
    reals          how REAL32 are written
    node_name      NodeName of the DCF, empty: module_20h
    bus_words      python-can's own, for bitrate and channel
    """

    configuration: DeviceConfiguration
    out: Path | None = None
    concise: Path | None = None
    table_inline: bool = True
    reals: Reals = Reals.DECIMAL
    node_name: str = ""
    bus_words: Mapping[str, Any] | None = None

    @property
    def path(self) -> Path:
        """The DCF."""
        return self.out or Path(f"module-{self.configuration.node_id:02X}h.dcf")

    @property
    def table_path(self) -> Path | None:
        """Beside the DCF; None: there is no table."""
        return self.path.with_suffix(".table.bin") if self.configuration.table else None

    def write(self, date: str, time: str) -> None:
        """``date`` mm-dd-yyyy, ``time`` hh:mmAM (CiA 306). CanfbError."""
        _put(self.path, self._text(date, time).encode("ascii", errors="replace"))
        if self.table_path is not None:
            _put(self.table_path, self.configuration.table)
        if self.concise is not None:
            _put(self.concise, encode_concise(self.configuration.writes()))

    def _text(self, date: str, time: str) -> str:
        configuration, words = self.configuration, self.bus_words or {}
        bit_rate, channel = words.get("bitrate"), words.get("channel")
        return dcf_text(
            eds_path(EDS),
            FileInfo(
                file_name=self.path.name,
                description=f"Configuration of a drive feedback module, node-ID {configuration.node_id}",
                date=date,
                time=time,
            ),
            Commissioning(
                node_id=configuration.node_id,
                node_name=self.node_name or f"module_{configuration.node_id:02X}h",
                bit_rate_kbit_s=round(bit_rate / 1000) if isinstance(bit_rate, int) else None,
                network_name="CANopen" if channel is None else str(channel),
                serial_number=configuration.serial_number,
            ),
            configuration.values(with_table=self.table_inline),
            reals=self.reals,
            files=None if self.table_path is None else {od.TABLE_STAGED: self.table_path.name},
        )

    def summary(self) -> dict[str, Any]:
        """For programs."""
        configuration = self.configuration
        return {
            "dcf": str(self.path),
            "concise": None if self.concise is None else str(self.concise),
            "table": None if self.table_path is None else str(self.table_path),
            "node_id": configuration.node_id,
            "serial_number": configuration.serial_number,
            "parameters": len(configuration.settings),
            "changed": {od.place_text(place): value for place, value in configuration.changed().items()},
            "table_crc32": f"{configuration.table_crc32:08X}",
            "table_entries": len(configuration.table) // 4,
            "concise_writes": len(configuration.writes()),
            "refused_in_index_order": list(map(od.place_text, configuration.refused_in_index_order())),
        }

    def lines(self) -> list[str]:
        """For people."""
        configuration, changed = self.configuration, self.configuration.changed()
        node_id = configuration.node_id
        others = f"not at factory defaults: {place_names(list(changed))}" if changed else "factory defaults"
        count = len(configuration.settings)
        lines = [f"{self.path}: node {node_id} ({node_id:02X}h), {count} parameters; {others}"]
        if self.table_path is not None:
            size, crc32 = len(configuration.table) // 4, configuration.table_crc32
            lines.append(f"{self.table_path}: correction table, {size} entries, {crc32:08X}")
        if self.concise is not None:
            lines.append(f"{self.concise}: the concise form, {len(configuration.writes())} writes")
        return lines


def place_names(places: list[Place]) -> str:
    """1017:00, 2010:03."""
    return ", ".join(od.place_text(place) for place in places)


def _put(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except OSError as error:
        raise CanfbError(f"cannot write {path}: {error.strerror}") from None
