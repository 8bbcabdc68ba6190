"""Which PDO carries the samples, and where in it: read from the nodes, which know best."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from canfb import objects as od
from canfb.cia301 import cob
from canfb.master.access import CommissioningError, NodeAccess, ObjectAbsentError
from canfb.view.pdo_map import Pdo, valid_pdos

INTERFACE_TRACKS = (od.INTERFACE_SINE.mapped(16), od.INTERFACE_COSINE.mapped(16))
PREDEFINED = (cob.TPDO1, cob.TPDO2, cob.TPDO3, cob.TPDO4)
MODULE_TRACKS = (od.SAMPLE_SINE.mapped(16), od.SAMPLE_COSINE.mapped(16))
MODULE_COARSE_TRACKS = (od.SAMPLE_COARSE_SINE.mapped(16), od.SAMPLE_COARSE_COSINE.mapped(16))
INTERFACE_EARLIER = tuple((sine.mapped(16), cosine.mapped(16)) for sine, cosine in od.INTERFACE_EARLIER)
MODULE_EARLIER = tuple((sine.mapped(16), cosine.mapped(16)) for sine, cosine in od.SAMPLE_EARLIER)
SAMPLE_TIMES = (od.INTERFACE_SAMPLE_TIME.mapped(32), od.SAMPLE_TIME.mapped(32))


@dataclass(frozen=True)
class PdoLayout:
    """COB-ID of the PDO with the samples, the bytes of both tracks in it, and the COB-ID of the SYNC.

    ``time_byte`` is where the sample time begins, None if it is not in that PDO; ``timed_by`` is another PDO
    that brings it. ``earlier`` are the PDOs, this one or others, and the bytes of earlier pairs in the same
    interval of SYNC, the newest first. ``coarse`` is the PDO with the coarse track, if it is listened to.
    """

    can_id: int
    sine_byte: int = 0
    cosine_byte: int = 2
    sync_id: int = cob.SYNC
    time_byte: int | None = None
    coarse: PdoLayout | None = None
    earlier: tuple[PdoLayout, ...] = ()
    timed_by: PdoLayout | None = None

    @property
    def others(self) -> list[int]:
        """COB-IDs of the other PDOs that bring a part of the sample."""
        parts = (*self.earlier, *(() if self.timed_by is None else (self.timed_by,)))
        return sorted({part.can_id for part in parts} - {self.can_id})

    @property
    def is_timed(self) -> bool:
        """Sample times come."""
        return self.time_byte is not None or self.timed_by is not None

    @property
    def sender(self) -> int | None:
        """The node that sends it by the predefined connection set, None for another COB-ID."""
        return (self.can_id & 0x7F or None) if self.can_id & 0x780 in PREDEFINED else None

    def unpack(self, data: bytes) -> tuple[int, int] | None:
        """Sine and cosine, counts; None for a PDO that is too short."""
        if len(data) < max(self.sine_byte, self.cosine_byte) + 2:
            return None
        return (
            int.from_bytes(data[self.sine_byte : self.sine_byte + 2], "little", signed=True),
            int.from_bytes(data[self.cosine_byte : self.cosine_byte + 2], "little", signed=True),
        )

    def sample_time(self, data: bytes) -> int | None:
        """Sample time, 100 ns, modulo 2^32; None for a PDO that has none."""
        begin = self.time_byte
        if begin is None or len(data) < begin + 4:
            return None
        return int.from_bytes(data[begin : begin + 4], "little")


def module_layout(module: NodeAccess) -> PdoLayout | None:
    """The RPDO from which the module takes its samples, None if it has none."""
    return _find(module, od.RPDO, od.RPDO_MAPPING, MODULE_TRACKS, MODULE_EARLIER)


def coarse_layout(module: NodeAccess) -> PdoLayout | None:
    """The RPDO from which the module takes the coarse track, None if it has none."""
    return _find(module, od.RPDO, od.RPDO_MAPPING, MODULE_COARSE_TRACKS, ())


def interface_layout(interface: NodeAccess) -> PdoLayout | None:
    """The TPDO in which the encoder interface sends both tracks, None if it has none."""
    return _find(interface, od.TPDO, od.TPDO_MAPPING, INTERFACE_TRACKS, INTERFACE_EARLIER)


def agreed_layout(module: NodeAccess | None, interface: NodeAccess) -> PdoLayout:
    """The PDO that the interface sends and the module takes.

    CommissioningError if both are known and differ: the table would be that of another encoder.
    An interface that does not answer is taken to send as the module expects it, or by default, unless the
    PDO that the module takes is that of another node.
    """
    taken = module_layout(module) if module is not None else None
    if module is not None and taken is None:
        raise CommissioningError(
            f"{module.name} has no valid RPDO with both tracks (2000:01, 2000:02): map and enable one; for a "
            "module with its own ADC: --source recording --recorder module"
        )
    if not interface.answers():
        if module is not None and taken is not None and taken.sender not in (None, interface.node_id):
            raise CommissioningError(
                f"{interface.name} does not answer, and {module.name} receives its samples from node "
                f"{taken.sender} ({taken.sender:02X}h, PDO {taken.can_id:03X}h): set the right "
                "--encoder-interface, or link the PDOs (1400:01)"
            )
        return taken or PdoLayout(cob.TPDO1 + interface.node_id)
    sent = interface_layout(interface)
    if sent is None:
        raise CommissioningError(
            f"{interface.name} has no valid TPDO with both tracks (6401:01, 6401:02): map and enable one"
        )
    if module is not None and taken is not None and taken.can_id != sent.can_id:
        raise CommissioningError(
            f"{module.name} receives its samples in PDO {taken.can_id:03X}h, but {interface.name} sends "
            f"them in {sent.can_id:03X}h: set the right --encoder-interface, or link the PDOs (1400:01)"
        )
    return sent


def _find(
    node: NodeAccess,
    parameters: int,
    mapping: int,
    entries_of_pair: tuple[int, int],
    earlier: Sequence[tuple[int, int]],
) -> PdoLayout | None:
    pdos = list(_pdos(node, parameters, mapping, entries_of_pair if not earlier else None))
    found = _carrier(pdos, entries_of_pair)
    if found is None:
        return None
    can_id, places, time_byte = found
    others = itertools.takewhile(_is_there, (_carrier(pdos, pair) for pair in earlier))
    pairs = tuple(PdoLayout(other[0], *other[1]) for other in others if other is not None)
    times = [(pdo.can_id, byte) for pdo in pdos if (byte := _time_place(pdo)) is not None]
    timed_by = None
    if earlier and time_byte is None and times:
        timed_by = PdoLayout(times[0][0], time_byte=times[0][1])
    return PdoLayout(can_id, *places, _sync_id(node), time_byte, None, pairs, timed_by)


def _pdos(node: NodeAccess, parameters: int, mapping: int, last: tuple[int, int] | None) -> Iterator[Pdo]:
    """The valid PDOs; up to the one with the objects ``last``."""
    for pdo in valid_pdos(node.read_known, parameters, mapping):
        yield pdo
        if last is not None and _places(pdo, last) is not None:
            return


def _carrier(
    pdos: Sequence[Pdo], entries_of_pair: tuple[int, int]
) -> tuple[int, tuple[int, int], int | None] | None:
    """COB-ID, bytes of both objects and of the sample time in the first PDO that has both objects."""
    for pdo in pdos:
        places = _places(pdo, entries_of_pair)
        if places is not None:
            return pdo.can_id, places, _time_place(pdo)
    return None


def _is_there(found: object) -> bool:
    return found is not None


def _sync_id(node: NodeAccess) -> int:
    try:
        return node.integer(*od.SYNC_COB_ID, "I") & cob.CAN_ID
    except ObjectAbsentError:
        return cob.SYNC


def _places(pdo: Pdo, entries_of_pair: tuple[int, int]) -> tuple[int, int] | None:
    """Bytes of both objects in this PDO."""
    at = pdo.bytes_of()
    return (
        (at[entries_of_pair[0]], at[entries_of_pair[1]])
        if all(one in at for one in entries_of_pair)
        else None
    )


def _time_place(pdo: Pdo) -> int | None:
    """Byte of the sample time in this PDO."""
    at = pdo.bytes_of()
    return next((at[one] for one in SAMPLE_TIMES if one in at), None)


def mapped_objects(module: NodeAccess) -> set[int]:
    """All mapping entries of the valid RPDOs of a module: index, sub-index and bits, as in 1600h."""
    pdos = valid_pdos(module.read_known, od.RPDO, od.RPDO_MAPPING)
    return {entry for pdo in pdos for entry in pdo.entries}
