"""What the EDS files say, as python canopen reads them: independent of the loader of the device."""

from canopen.objectdictionary import ODVariable

from eds_text import eds_of

VISIBLE_STRING, DOMAIN = 0x09, 0x0F


class EdsEntry:
    """One sub-index, as the file has it; ``flags`` are its ObjFlags (CiA 306)."""

    def __init__(self, variable: ODVariable, flags: int) -> None:
        self.index, self.sub, self.flags = variable.index, variable.subindex, flags
        self.data_type, self.access = variable.data_type, variable.access_type
        self.mappable, self.low, self.high = variable.pdo_mappable, variable.min, variable.max
        self.size = len(variable) // 8 if self.data_type in variable.STRUCT_TYPES else 0
        """Bytes of a value; 0 for strings and DOMAIN."""
        self.default = b"" if variable.default is None else variable.encode_raw(variable.default)
        """The bytes of it; none if there is no default."""
        self.readable, self.writable = self.access != "wo", self.access in ("rw", "wo", "rww", "rwr")
        self.mapping = self.index << 16 | self.sub << 8 | 8 * self.size
        """The entry of a PDO mapping that names this object."""
        self.m = f"{self.index & 0xFF:02X} {self.index >> 8:02X} {self.sub:02X}"
        """Multiplexer of an SDO frame: index low, index high, sub-index."""

    def __str__(self) -> str:
        return f"{self.index:04X}_{self.sub:02X}"


class Eds:
    def __init__(self, name: str, node_id: int) -> None:
        self.name, self.node_id = name, node_id
        text = eds_of(name, node_id)
        self.sections = text.sections
        listed = [(index, sub, text.sections[section]) for index, sub, section in text.listed()]
        self.objects = {index: int(options["ObjectType"], 0) for index, sub, options in listed if sub is None}
        """Object type by index."""
        self.options = {(index, sub or 0): options for index, sub, options in listed}
        flags = {place: int(options.get("ObjFlags", "0"), 0) for place, options in self.options.items()}
        self.entries = {place: EdsEntry(entry, flags[place]) for place, entry in text.entries.items()}

    def has(self, index: int, sub: int = 0) -> bool:
        return (index, sub) in self.entries

    def __getitem__(self, key: tuple[int, int]) -> EdsEntry:
        return self.entries[key]

    @property
    def dummies(self) -> set[int]:
        """Data types that an RPDO may map to fill a gap."""
        usage = self.sections["DummyUsage"]
        return {int(name.removeprefix("Dummy"), 16) for name, is_on in usage.items() if is_on == "1"}

    def pdos(self, first: int) -> list[int]:
        """Where the communication parameters of the PDOs are, which begin at `first`."""
        return [index for index in range(first, first + 0x200) if self.has(index, 1)]

    def mappable(self, *access: str, size: int | None = None) -> list[EdsEntry]:
        """Objects that a PDO may carry, with this access, of `size` bytes."""
        return [
            entry
            for entry in self.entries.values()
            if entry.mappable and entry.access in access and size in (None, entry.size)
        ]
