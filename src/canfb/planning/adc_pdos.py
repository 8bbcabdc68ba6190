"""The RPDOs of a planned module that bring its samples: how many pairs, with their time or without."""

from __future__ import annotations

from typing import Any

from canfb import objects as od
from canfb.cia301 import cob
from canfb.cia301.pdo_room import mapping_values
from canfb.device.od.dcf import Place
from canfb.planning.traffic import Values, mapped_bytes, mapped_objects, valid_pdos

NEWEST = (od.SAMPLE_SINE, od.SAMPLE_COSINE)
TIME = od.SAMPLE_TIME.mapped(32)
NODE_ID = 0x7F


def _pair(sine: od.Multiplexer, cosine: od.Multiplexer) -> set[int]:
    return {sine.mapped(16), cosine.mapped(16)}


def _mapped(values: Values) -> dict[int, list[int]]:
    """What the RPDOs that are valid carry of 2000h, by their number."""
    found = {
        number: mapped_objects(values, od.RPDO_MAPPING + number - 1)
        for number, _ in valid_pdos(values, od.RPDO)
    }
    sample = od.SAMPLE_SINE.object_index
    return {number: mapped for number, mapped in found.items() if any(one >> 16 == sample for one in mapped)}


def samples_per_sync(values: Values) -> int:
    """The pairs that RPDOs carry, up to the first that none does, as the module counts them; at least 1."""
    return od.samples_per_sync(list(_mapped(values).values()))


def sample_bytes(values: Values) -> int:
    """Data bytes of all PDOs that bring one sample."""
    return sum(mapped_bytes(values, od.RPDO_MAPPING + number - 1) for number in _mapped(values))


def has_time(values: Values) -> bool:
    """An RPDO brings the time of each sample."""
    return any(TIME in one for one in _mapped(values).values())


def laid_out(values: Values, pairs: int, times: bool) -> dict[Place, Any]:
    """The objects of the RPDOs with ``pairs`` 1..4 pairs of each SYNC, and the time of the newest or not.

    What else they bring of the sample stays. They are filled in their order, those of the same interface
    first, then those that are not in use. ValueError if there are too few.
    """
    mapped = _mapped(values)
    tracks = next((number for number, one in mapped.items() if _pair(*NEWEST) <= set(one)), None)
    if tracks is None:
        raise ValueError("samples_per_sync needs an RPDO that brings 2000:01 and 2000:02")
    cob_ids = dict(valid_pdos(values, od.RPDO))
    interface = cob_ids[tracks] & NODE_ID
    own = [number for number in mapped if cob_ids[number] & NODE_ID == interface]
    wanted = [one.mapped(16) for pair in (NEWEST, *od.SAMPLE_EARLIER)[:pairs] for one in pair]
    wanted += [TIME] if times else []
    known = {one.mapped(16) for pair in (NEWEST, *od.SAMPLE_EARLIER) for one in pair} | {TIME}
    wanted += [entry for number in own for entry in mapped[number] if entry not in known]
    return _filled(values, own, interface, wanted)


def _filled(values: Values, own: list[int], interface: int, wanted: list[int]) -> dict[Place, Any]:
    """These entries in the RPDOs ``own`` of an interface, and in others that are not valid."""
    in_use = {number for number, _ in valid_pdos(values, od.RPDO)}
    free = [number for number in range(1, len(cob.TPDOS) + 1) if number not in in_use]
    numbers = own + [number for number in free if (od.RPDO + number - 1, 1) in values]
    changed: dict[Place, Any] = {}
    pdos = mapping_values(0, wanted)  # by the place of the PDO among ``numbers``
    needed = 1 + max(place for place, _ in pdos)
    if needed > len(numbers):
        raise ValueError(f"the samples need {needed} RPDOs, and there are {len(numbers)} for them")
    for (place, subindex), value in pdos.items():
        changed[od.RPDO_MAPPING + numbers[place] - 1, subindex] = value
    for number in numbers[len(own) : needed]:
        changed[od.RPDO + number - 1, 1] = cob.TPDOS[number - 1] + interface
    for number in own[needed:]:
        changed[od.RPDO + number - 1, 1] = cob.NOT_VALID | values[od.RPDO + number - 1, 1]
    return changed
