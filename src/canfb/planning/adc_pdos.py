"""The RPDOs of a planned module that bring its samples: their bytes, and another layout of them."""

from __future__ import annotations

from typing import Any

from canfb import objects as od
from canfb.cia301 import cob
from canfb.cia301.frame import mapping_values
from canfb.device.od.dcf import Place
from canfb.planning.traffic import Values
from canfb.view.pdo_map import Pdo, valid_pdos

NEWEST = (od.SAMPLE_SINE, od.SAMPLE_COSINE)
TIME = od.SAMPLE_TIME.mapped(32)
NODE_ID = 0x7F


def _pair(sine: od.Multiplexer, cosine: od.Multiplexer) -> set[int]:
    return {sine.mapped(16), cosine.mapped(16)}


def _of_samples(values: Values) -> list[Pdo]:
    """The valid RPDOs that bring a part of the sample (2000h)."""
    pdos = valid_pdos(values.get, od.RPDO, od.RPDO_MAPPING)
    return [pdo for pdo in pdos if pdo.carries(od.SAMPLE_SINE.object_index)]


def sample_bytes(values: Values) -> int:
    """Data bytes of all PDOs that bring one sample."""
    return sum(pdo.length_bytes for pdo in _of_samples(values))


def laid_out(values: Values, pairs: int, times: bool) -> dict[Place, Any]:
    """The objects of the RPDOs with ``pairs`` 1..4 pairs of each SYNC, and the time of the newest or not.

    What else they bring of the sample stays. They are filled in their order, those of the same interface
    first, then those that are not in use. ValueError if there are too few.
    """
    pdos = _of_samples(values)
    tracks = next((pdo for pdo in pdos if _pair(*NEWEST).issubset(pdo.entries)), None)
    if tracks is None:
        raise ValueError("samples_per_sync needs an RPDO that brings 2000:01 and 2000:02")
    interface = tracks.can_id & NODE_ID
    own = [pdo for pdo in pdos if pdo.can_id & NODE_ID == interface]
    entries = [one.mapped(16) for pair in (NEWEST, *od.SAMPLE_EARLIER)[:pairs] for one in pair]
    entries += [TIME] if times else []
    known = {one.mapped(16) for pair in (NEWEST, *od.SAMPLE_EARLIER) for one in pair} | {TIME}
    entries += [entry for pdo in own for entry in pdo.entries if entry not in known]
    return _filled(values, [pdo.number for pdo in own], interface, entries)


def _filled(values: Values, own: list[int], interface: int, entries: list[int]) -> dict[Place, Any]:
    """These entries in the RPDOs ``own`` of an interface, and in others that are not valid."""
    in_use = {pdo.number for pdo in valid_pdos(values.get, od.RPDO, od.RPDO_MAPPING)}
    free = [number for number in range(1, len(cob.TPDOS) + 1) if number not in in_use]
    numbers = own + [number for number in free if (od.RPDO + number - 1, 1) in values]
    changed: dict[Place, Any] = {}
    pdos = mapping_values(0, entries)  # by the place of the PDO among ``numbers``
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
