"""LSS slave: node-ID and bit rate over the bus (CiA 305).

A master finds a device by its address, the four numbers of 1018h (vendor, product, revision, serial
number): it selects one that it knows, asks for ranges, or searches bit by bit (fastscan). A selected slave
is in the configuration state and takes a node-ID, a bit rate, and "store". The new node-ID is in force from
the next reset of the communication on, a first one at once. LSS answers in every NMT state, also without a
node-ID (255).
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from enum import IntEnum
from typing import NamedTuple

from canfb.cia301.codes import SdoAbort
from canfb.cia301.frame import Frame
from canfb.device.core import Core
from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.image import ParameterGroup, Record
from canfb.device.storage.storage import Storage

Address = tuple[int, int, int, int]
"""Vendor-ID, product code, revision number, serial number: the LSS address."""

SELECT = range(0x40, 0x44)
"""Switch state selective: one frame for each part of the address."""
IDENTIFY = range(0x46, 0x4C)
"""Identify remote slave: vendor-ID, product code, lowest and highest revision, and serial number."""
IDENTIFY_NON_CONFIGURED = 0x4C
FASTSCAN = 0x51

_CONFIRM = 128  # of the fastscan: is there any device without a node-ID?
_PARTS = 4


class LssResponse(IntEnum):
    """Command specifiers of the slave's answers."""

    SELECTED = 0x44
    IDENTIFIED = 0x4F
    NON_CONFIGURED = 0x50


class LssReply(NamedTuple):
    """What to send, and whether the slave is selected by it: it goes to the configuration state."""

    command: LssResponse
    selected: bool = False


class Identification:
    """The services that look for devices. What they ask over several frames is kept between them."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._entries = [dictionary.assumed(0x1018, subindex) for subindex in range(1, _PARTS + 1)]
        self.reset()

    def reset(self) -> None:
        """Forget what was asked so far."""
        self._selection: list[int] = []
        self._range: list[int] = []
        self._scanned = 0  # the part of the address that the fastscan is at

    @property
    def address(self) -> Address:
        """The LSS address of the device; parts that 1018h does not have are 0."""
        vendor, product, revision, serial = (int(entry.value) for entry in self._entries)
        return vendor, product, revision, serial

    def handle(self, data: bytes, *, unconfigured: bool, waiting: bool) -> LssReply | None:
        """A frame of 8 bytes; what to answer, if anything.

        `unconfigured`: the device has no node-ID. `waiting`: it is in the waiting state.
        """
        command, number = data[0], int.from_bytes(data[1:5], "little")
        if command in SELECT:
            return self._select(command - SELECT.start, number) if waiting else None
        if command in IDENTIFY:
            return self._identify(command - IDENTIFY.start, number)
        if command == IDENTIFY_NON_CONFIGURED:
            return LssReply(LssResponse.NON_CONFIGURED) if unconfigured else None
        if command == FASTSCAN and unconfigured and waiting:
            return self._fastscan(number, *data[5:8])
        return None

    def _select(self, part: int, number: int) -> LssReply | None:
        self._selection = _collected(self._selection, part, number)
        if tuple(self._selection) != self.address:
            return None
        self._selection = []
        return LssReply(LssResponse.SELECTED, selected=True)

    def _identify(self, part: int, number: int) -> LssReply | None:
        self._range = _collected(self._range, part, number)
        if len(self._range) < len(IDENTIFY):
            return None
        vendor, product, revision_low, revision_high, serial_low, serial_high = self._range
        self._range = []
        own_vendor, own_product, revision, serial = self.address
        found = (
            (vendor, product) == (own_vendor, own_product)
            and revision_low <= revision <= revision_high
            and serial_low <= serial <= serial_high
        )
        return LssReply(LssResponse.IDENTIFIED) if found else None

    def _fastscan(self, number: int, bit: int, part: int, following: int) -> LssReply | None:
        """Compare the part down to `bit`; the master goes on with the part `following`."""
        if bit == _CONFIRM:
            self._scanned = 0
            return LssReply(LssResponse.IDENTIFIED)
        if bit > 31 or part >= _PARTS or following >= _PARTS or part != self._scanned:
            return None
        if (number ^ self.address[part]) >> bit:
            return None
        self._scanned = following
        complete = bit == 0 and following < part
        return LssReply(LssResponse.IDENTIFIED, selected=complete)


def _collected(parts: list[int], part: int, number: int) -> list[int]:
    """The parts so far and this one, if it is their next; the first one restarts."""
    if part == 0:
        return [number]
    return [*parts, number] if len(parts) == part else []


REQUEST_ID, RESPONSE_ID = 0x7E5, 0x7E4
UNCONFIGURED = 255
"""The node-ID of a device that has none yet."""

BIT_RATES_KBIT_S = {0: 1000, 1: 800, 2: 500, 3: 250, 4: 125, 6: 50, 7: 20, 8: 10}
"""The standard table of bit timings; 5 is reserved."""

_LENGTH = 8
_NODE_ID_RECORD, _BIT_RATE_RECORD = (0, 1), (0, 2)
_NO_BIT_RATE = 0xFF


class LssState(IntEnum):
    """The state of the slave, with the value of the service "switch state global"."""

    WAITING = 0
    CONFIGURATION = 1


class LssCommand(IntEnum):
    """Command specifiers of the services beside identification."""

    SWITCH_STATE_GLOBAL = 0x04
    CONFIGURE_NODE_ID = 0x11
    CONFIGURE_BIT_TIMING = 0x13
    ACTIVATE_BIT_TIMING = 0x15
    STORE_CONFIGURATION = 0x17
    INQUIRE_IDENTITY = 0x5A
    """5Ah to 5Dh: vendor-ID, product code, revision number, serial number."""
    INQUIRE_NODE_ID = 0x5E


CHANGES = frozenset(
    {
        LssCommand.CONFIGURE_NODE_ID,
        LssCommand.CONFIGURE_BIT_TIMING,
        LssCommand.ACTIVATE_BIT_TIMING,
        LssCommand.STORE_CONFIGURATION,
    }
)


class Error(IntEnum):
    """What a service answers; 1 is its own kind of refusal."""

    NONE = 0
    NOT_POSSIBLE = 1
    STORE_FAILED = 2


def is_node_id(value: int) -> bool:
    """Whether a device may have this node-ID: 1 to 127, or 255 for none."""
    return 1 <= value <= 127 or value == UNCONFIGURED


class LssSlave:
    """Answers the LSS master, in every NMT state.

    `pending_node_id` is what the next reset of the communication makes the node-ID, and what is
    stored. `bit_rates_kbit_s` are those that the bus can be set to. "Activate bit timing" takes the bit
    rate configured before; it has no answer. Without one that the bus can be set to nothing happens.
    """

    def __init__(self, core: Core, storage: Storage, bit_rates_kbit_s: Collection[int]) -> None:
        self.state = LssState.WAITING
        self.pending_node_id = self._own_node_id = core.node_id
        self.bit_rate_kbit_s: int | None = None
        """The bit rate that was configured or stored, None for none."""
        self._core = core
        self._storage = storage
        self._bit_rates_kbit_s = frozenset(bit_rates_kbit_s)
        self._identification = Identification(core.dictionary)
        self._services: dict[int, Callable[[bytes], None]] = {
            LssCommand.CONFIGURE_NODE_ID: self._configure_node_id,
            LssCommand.CONFIGURE_BIT_TIMING: self._configure_bit_timing,
            LssCommand.ACTIVATE_BIT_TIMING: self._activate_bit_timing,
            LssCommand.STORE_CONFIGURATION: self._store,
            LssCommand.INQUIRE_NODE_ID: self._inquire_node_id,
            **{LssCommand.INQUIRE_IDENTITY + part: self._inquire_identity for part in range(4)},
        }

    def power_on(self) -> None:
        """Take what is stored, or else the node-ID that the program gave."""
        self.pending_node_id, self.bit_rate_kbit_s = self._own_node_id, None
        records = self._storage.records(ParameterGroup.LSS)
        if records is None:
            return
        values = {(record.index, record.subindex): record.data for record in records}
        node_id = int.from_bytes(values.get(_NODE_ID_RECORD, b""), "little")
        timing = int.from_bytes(values.get(_BIT_RATE_RECORD, b""), "little")
        if not is_node_id(node_id):
            self._storage.refuse(ParameterGroup.LSS, f"{node_id} is not a node-ID")
            return
        self.pending_node_id = node_id
        self.bit_rate_kbit_s = BIT_RATES_KBIT_S.get(timing)

    def reset(self) -> None:
        """The state after an NMT reset."""
        self.state = LssState.WAITING
        self._identification.reset()

    def handle(self, data: bytes, now: float) -> None:
        """A frame of the master; one that is not 8 bytes long is dropped."""
        if len(data) != _LENGTH:
            self._core.counters.malformed_frames += 1
        elif data[0] == LssCommand.SWITCH_STATE_GLOBAL:
            self._switch_state(data[1], now)
        elif data[0] in self._services:
            if self.state is LssState.CONFIGURATION:
                self._serve(data)
        else:
            self._identify(data)

    def _serve(self, data: bytes) -> None:
        """A service in CONFIGURATION; one that changes something is refused while the node is locked."""
        if data[0] in CHANGES and self._is_locked():
            if data[0] != LssCommand.ACTIVATE_BIT_TIMING:  # which has no answer
                self._answer(bytes([data[0], Error.NOT_POSSIBLE]))
            return
        self._services[data[0]](data)

    def _is_locked(self) -> bool:
        try:
            self._core.application.check_write(None)
        except SdoAbort:
            return True
        return False

    def _switch_state(self, mode: int, now: float) -> None:
        if mode == LssState.CONFIGURATION:
            self.state = LssState.CONFIGURATION
        elif mode == LssState.WAITING and self.state is LssState.CONFIGURATION:
            self.state = LssState.WAITING
            self._core.reactions.lss_left(now)

    def _identify(self, data: bytes) -> None:
        unconfigured = self._core.node_id == self.pending_node_id == UNCONFIGURED
        waiting = self.state is LssState.WAITING
        answer = self._identification.handle(data, unconfigured=unconfigured, waiting=waiting)
        if answer is None:
            return
        if answer.selected:
            self.state = LssState.CONFIGURATION
        self._answer(bytes([answer.command]))

    def _answer(self, data: bytes) -> None:
        self._core.emit(Frame(RESPONSE_ID, data.ljust(_LENGTH, b"\x00")))

    def _configure_node_id(self, data: bytes) -> None:
        good = is_node_id(data[1])
        if good:
            self.pending_node_id = data[1]
        self._answer(bytes([data[0], Error.NONE if good else Error.NOT_POSSIBLE]))

    def _configure_bit_timing(self, data: bytes) -> None:
        table, index = data[1:3]
        kbit_s = BIT_RATES_KBIT_S.get(index)
        good = table == 0 and kbit_s in self._bit_rates_kbit_s
        if good:
            self.bit_rate_kbit_s = kbit_s
        self._answer(bytes([data[0], Error.NONE if good else Error.NOT_POSSIBLE]))

    def _activate_bit_timing(self, data: bytes) -> None:
        """There is no answer. Nothing happens without a bit rate that was configured and is possible."""
        if self.bit_rate_kbit_s is not None and self.bit_rate_kbit_s in self._bit_rates_kbit_s:
            delay_s = int.from_bytes(data[1:3], "little") / 1000
            self._core.reactions.bit_rate_activated(self.bit_rate_kbit_s, delay_s)

    def _store(self, data: bytes) -> None:
        timing = next(
            (index for index, rate in BIT_RATES_KBIT_S.items() if rate == self.bit_rate_kbit_s), _NO_BIT_RATE
        )
        records = [
            Record(*_NODE_ID_RECORD, False, bytes([self.pending_node_id])),
            Record(*_BIT_RATE_RECORD, False, bytes([timing])),
        ]
        if not self._storage.is_there:
            self._answer(bytes([data[0], Error.NOT_POSSIBLE]))
            return

        def done(error: OSError | None) -> None:
            self._answer(bytes([data[0], Error.NONE if error is None else Error.STORE_FAILED]))

        self._storage.save_records(ParameterGroup.LSS, records, done)

    def _inquire_node_id(self, data: bytes) -> None:
        self._answer(bytes([data[0], self._core.node_id]))

    def _inquire_identity(self, data: bytes) -> None:
        number = self._identification.address[data[0] - LssCommand.INQUIRE_IDENTITY]
        self._answer(bytes([data[0]]) + number.to_bytes(4, "little"))
