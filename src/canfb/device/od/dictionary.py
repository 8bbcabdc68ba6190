"""The object dictionary: entries by index and sub-index, loaded from an EDS file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

from canfb.cia301 import datatypes
from canfb.cia301.codes import AbortCode, SdoAbort
from canfb.device.od import eds
from canfb.device.od.eds import Description
from canfb.errors import saying

READABLE = frozenset({"ro", "rw", "rwr", "rww", "const"})
WRITABLE = frozenset({"wo", "rw", "rwr", "rww"})
TPDO_ACCESS = frozenset({"ro", "rw", "rwr", "const"})
RPDO_ACCESS = frozenset({"wo", "rw", "rww"})


@dataclass(slots=True, eq=False)
class Entry:
    """A sub-index of the object dictionary (CiA 301, 7.4).

    The owner of the object assigns `value` without checks; SDO and PDO pass them. `access` is ro, wo, rw,
    const, rww (rw, mappable into an RPDO only) or rwr (into a TPDO only). `low` and `high` limit values from
    the bus.

    `on_read()` gives a live value, `on_check(value)` may raise SdoAbort before the write, `on_written()` acts
    on the new `value` or refuses it, `on_download()` runs after an SDO write. `follows_node_id`: the default
    contains $NODEID.
    """

    index: int
    subindex: int
    data_type: int
    _: KW_ONLY
    name: str = ""
    access: str = "rw"
    default: Any = None
    low: float | None = None
    high: float | None = None
    pdo_mappable: bool = False
    follows_node_id: bool = False
    on_read: Callable[[], Any] | None = field(default=None, init=False)
    on_check: Callable[[Any], None] | None = field(default=None, init=False)
    on_written: Callable[[], None] | None = field(default=None, init=False)
    on_download: Callable[[], None] | None = field(default=None, init=False)
    # Read for every frame, hence not a property; its type is that of the object.
    value: Any = field(init=False)

    def __post_init__(self) -> None:
        if self.data_type not in datatypes.KNOWN:
            raise ValueError(
                f"{self.index:04X}h:{self.subindex:02X} has the unknown data type {self.data_type:#06x}; see "
                "CiA 301, 7.4.7"
            )
        self.reset()

    def __repr__(self) -> str:
        return f"<Entry {self.index:04X}h:{self.subindex:02X} {self.name!r} = {self.value!r}>"

    def fresh(self) -> Entry:
        other = object.__new__(Entry)
        for name in Entry.__slots__:  # copy.copy takes four times as long, and a module has 420 of them
            setattr(other, name, getattr(self, name))
        return other

    def reset(self) -> None:
        """Set the default, or zero. No hook runs."""
        self.value = datatypes.zero(self.data_type) if self.default is None else self.default

    @property
    def bit_length(self) -> int:
        return datatypes.bit_length(self.data_type)

    @property
    def byte_length(self) -> int:
        return datatypes.byte_length(self.data_type)

    def current(self) -> Any:
        return self.value if self.on_read is None else self.on_read()

    def encode(self) -> bytes:
        value = self.current()
        try:
            return datatypes.encode(self.data_type, value)
        except ValueError as error:
            raise ValueError(f"{self!r}: {error}") from error

    def decode(self, data: bytes) -> Any:
        size = self.byte_length
        if size and len(data) != size:
            raise SdoAbort(AbortCode.TOO_LONG if len(data) > size else AbortCode.TOO_SHORT)
        value = datatypes.decode(self.data_type, data)
        self.check_limits(value)
        return value

    def check_limits(self, value: Any) -> None:
        """SdoAbort for a value beyond `low` or `high`, and for NaN."""
        if self.high is not None and not value <= self.high:
            raise SdoAbort(AbortCode.VALUE_TOO_HIGH if value > self.high else AbortCode.INVALID_VALUE)
        if self.low is not None and not value >= self.low:
            raise SdoAbort(AbortCode.VALUE_TOO_LOW if value < self.low else AbortCode.INVALID_VALUE)

    def check(self, value: Any) -> None:
        self.check_limits(value)
        if self.on_check is not None:
            self.on_check(value)

    def check_writable(self) -> None:
        if self.access not in WRITABLE:
            raise SdoAbort(AbortCode.READ_ONLY)

    def store(self, value: Any) -> None:
        self.check(value)
        before, self.value = self.value, value
        if self.on_written is not None:
            try:
                self.on_written()
            except SdoAbort:
                self.value = before
                raise

    def upload(self) -> bytes:
        if self.access not in READABLE:
            raise SdoAbort(AbortCode.WRITE_ONLY)
        return self.encode()

    def download(self, data: bytes) -> None:
        self.check_writable()
        self.store(self.decode(data))
        if self.on_download is not None:
            self.on_download()


def is_accepted(take: Callable[[Any], None], value: Any) -> bool:
    """Whether ``take``, a check or a write, raises no SdoAbort."""
    try:
        take(value)
    except SdoAbort:
        return False
    return True


def refuse_if(
    wrong: Callable[[Any], object], code: AbortCode = AbortCode.INVALID_VALUE
) -> Callable[[Any], None]:
    """An `on_check` that refuses the values for which ``wrong`` is true."""

    def check(value: Any) -> None:
        if wrong(value):
            raise SdoAbort(code)

    return check


STORE_EDS = 0x1021  # The EDS of the device, in the format that 1022h names (CiA 301, 7.5.2.24).


class Dictionary:
    """The objects of one device (CiA 301, 7.4), in the order of their indices.

    `dummies` are the data types that may fill gaps in an RPDO (CiA 301, 7.4.7).
    """

    def __init__(
        self,
        entries: Iterable[Entry],
        objects: Iterable[int],
        dummies: Iterable[int] = (),
    ) -> None:
        self._entries = {
            (entry.index, entry.subindex): entry
            for entry in sorted(entries, key=lambda entry: (entry.index, entry.subindex))
        }
        self._objects = frozenset(objects)
        self.dummies = frozenset(dummies)

    @classmethod
    def load(cls, path: str | Path, node_id: int) -> Dictionary:
        """The objects of an EDS file for node `node_id` (1..127; 255 for none yet), all at their defaults.

        OSError if the file cannot be read, ValueError with the section for invalid contents.
        1021h is the file itself.
        """
        if not (1 <= node_id <= 127 or node_id == 255):
            raise ValueError(f"node-ID {node_id} is out of range; use 1 to 127, or 255 for none yet")
        content = Path(path).read_bytes()
        with saying(ValueError, str(path), ValueError):
            described = eds.content_described(content)
            template = _template(content, node_id)
        dictionary = cls([entry.fresh() for entry in template], described.objects, described.dummies)
        stored = dictionary.find(STORE_EDS)
        if stored is not None and stored.data_type == datatypes.DataType.DOMAIN:
            stored.default = stored.value = content
        return dictionary

    def entry(self, index: int, subindex: int = 0) -> Entry:
        try:
            return self._entries[index, subindex]
        except KeyError:
            raise KeyError(
                f"{index:04X}h:{subindex:02X} is not in this object dictionary; add it to the EDS"
            ) from None

    def read_live(self, values: Mapping[tuple[int, int], Callable[[], Any]]) -> None:
        for place, read in values.items():
            self.entry(*place).on_read = read

    def find(self, index: int, subindex: int = 0) -> Entry | None:
        return self._entries.get((index, subindex))

    def assumed(self, index: int, subindex: int = 0, value: int = 0) -> Entry:
        """The entry, or a dummy outside the dictionary with this value."""
        found = self.find(index, subindex)
        return (
            Entry(index, subindex, datatypes.DataType.UNSIGNED32, default=value) if found is None else found
        )

    def lookup(self, index: int, subindex: int) -> Entry:
        found = self._entries.get((index, subindex))
        if found is None:
            raise SdoAbort(AbortCode.NO_SUBINDEX if index in self._objects else AbortCode.NO_OBJECT)
        return found

    def __contains__(self, key: tuple[int, int]) -> bool:
        return key in self._entries

    def __iter__(self) -> Iterator[Entry]:
        return iter(self._entries.values())

    def indices(self, area: range) -> Sequence[int]:
        return sorted(index for index in self._objects if index in area)

    def without_count(self, index: int) -> list[Entry]:
        return [entry for (of, subindex), entry in self._entries.items() if of == index and subindex]

    def change_node_id(self, old: int, new: int) -> None:
        """Recalculate defaults that contain the node-ID, and values equal to such a default."""
        for entry in self._entries.values():
            if entry.follows_node_id and isinstance(entry.default, int):
                is_default = entry.value == entry.default
                entry.default += new - old
                if is_default:
                    entry.value = entry.default

    def reset(self, last: int = 0xFFFF) -> None:
        """Set the entries up to `last` to their defaults. No hook runs."""
        for entry in self._entries.values():
            if entry.index <= last:
                entry.reset()


@lru_cache(maxsize=32)
def _template(content: bytes, node_id: int) -> tuple[Entry, ...]:
    return tuple(_entry(one, node_id) for one in eds.content_described(content).entries)


def _entry(described: Description, node_id: int) -> Entry:
    default = described.value_of("DefaultValue", described.default, node_id)
    low, high = described.limits(node_id)
    try:
        entry = Entry(
            described.index,
            described.subindex,
            described.data_type,
            name=described.name,
            access=described.access,
            default=default,
            low=low,
            high=high,
            pdo_mappable=described.pdo_mappable,
            follows_node_id=described.follows_node_id,
        )
        entry.encode()
        if entry.default is not None:
            entry.check_limits(entry.default)
    except (ValueError, SdoAbort) as error:
        raise ValueError(f"[{described.section}]: {error}") from error
    return entry
