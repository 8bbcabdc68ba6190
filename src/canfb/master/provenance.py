"""Where, when and with what it was measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from canfb.master.machine_watch import Meanwhile
from canfb.rows import Row

ARC_SECONDS = 360.0 * 3600.0
PERCENT = 100.0


@dataclass(frozen=True)
class Provenance:
    """Where and when it was measured.

    date                   ISO 8601
    time                   time of day with the offset to UTC, ISO 8601; "" if not known
    version                of canfb; "" if not known
    command                the command line; "" if there was none
    identity               1018h of the module: vendor-ID, product code, revision, serial number
    interface_identity     1018h of the encoder interface
    module                 node id, None without a bus
    encoder_interface      node id, None without a bus
    encoder                name or serial number of the encoder, as the user gave it
    cycles_per_revolution  None if not known
    meanwhile              what the module said of itself before and after the samples; None if it did not
    """

    date: str
    module: int | None = None
    encoder_interface: int | None = None
    encoder: str = ""
    cycles_per_revolution: int | None = None
    time: str = ""
    version: str = ""
    command: str = ""
    identity: tuple[int, ...] | None = None
    interface_identity: tuple[int, ...] | None = None
    meanwhile: Meanwhile | None = None

    def arc_seconds(self, cycles: float) -> float | None:
        """A part of the cycle as an angle of the shaft."""
        return cycles * ARC_SECONDS / self.cycles_per_revolution if self.cycles_per_revolution else None


def origins(where: Provenance) -> list[Row]:
    """With what it was measured: nodes by their identity, program, command."""
    module, interface = where.module, where.encoder_interface
    rows = [
        Row("module", None if module is None else _node(module, where.identity)),
        Row("encoder interface", None if interface is None else _node(interface, where.interface_identity)),
        Row("program", f"canfb {where.version}" if where.version else None),
        Row("command", where.command or None),
    ]
    return [row for row in rows if row.words]


def _node(node_id: int, identity: tuple[int, ...] | None) -> str:
    words = f"{node_id} ({node_id:02X}h)"
    if identity is None:
        return words
    named = zip(("vendor", "product", "revision", "serial number"), identity, strict=False)
    return f"{words}; {', '.join(f'{name} {number}' for name, number in named)} (1018h)"


def where_words(where: Provenance) -> dict[str, Any]:
    """Provenance as keys and values."""
    return {
        "date": where.date,
        "time": where.time or None,
        "canfb": where.version or None,
        "command": where.command or None,
        "encoder": where.encoder or None,
        "module": where.module,
        "module_identity": _listed(where.identity),
        "encoder_interface": where.encoder_interface,
        "encoder_interface_identity": _listed(where.interface_identity),
        "cycles_per_revolution": where.cycles_per_revolution,
    }


def _listed(identity: tuple[int, ...] | None) -> list[int] | None:
    return None if identity is None else list(identity)


def percent(cycles: float, where: Provenance) -> str:
    """A part of the cycle in percent, and as an angle of the shaft where that is known."""
    arc = where.arc_seconds(cycles)
    words = f"{PERCENT * cycles:.3g} %"
    return words if arc is None else f"{words} ({arc:.2g}″)"
