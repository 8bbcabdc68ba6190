"""A bus for tools; objects of a node by SDO; its NMT state, detection of a restart, and restarting a module.

A module is restarted at standstill only: after a start it cannot distinguish whole cycles per interval from
standstill. So the machine is observed before the reset.
"""

from __future__ import annotations

import contextlib
import ctypes
import io
import itertools
import struct
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import can
from canopen.sdo.exceptions import SdoAbortedError, SdoError

from canfb import objects as od
from canfb.cia301 import cob
from canfb.cia301.codes import AbortCode, NmtCommand, NmtState
from canfb.errors import CanfbError, reason
from canfb.signal.speeds import STILL_SAMPLES, apart

# :class:`canfb.bus.sdo_channel.SharedClient`: canopen's client, with `turn` and `disturbed`.
Client = Any
SEGMENT = 7


def _fetch(client: Client, index: int, subindex: int, block: bool, progress: Progress) -> bytes:
    with _opened(client, index, subindex, "rb", block_transfer=block) as stream:
        chunks: list[bytes] = []
        while chunk := stream.read(SEGMENT):
            chunks.append(chunk)
            if stream.size and len(chunks) % 256 == 0:
                progress(min(1.0, SEGMENT * len(chunks) / stream.size))
        data = b"".join(chunks)
        return data[: stream.size] if stream.size else data


def _store(client: Client, index: int, subindex: int, data: bytes, block: bool) -> bytes:
    with _opened(client, index, subindex, "wb", size=len(data), block_transfer=block) as stream:
        sent = 0
        while sent < len(data):
            sent += stream.write(data[sent : sent + SEGMENT])
    return b""


@contextlib.contextmanager
def _opened(client: Client, *place: Any, **options: Any) -> Iterator[Any]:
    """A stream of canopen; any exception aborts the transfer.

    Closing the stream instead would end the transfer as if all data had been sent.
    """
    stream = client.open(*place, buffering=0, **options)
    try:
        yield stream
    except BaseException as error:
        io.RawIOBase.close(stream)
        if not isinstance(error, SdoAbortedError):
            client.abort()
        raise
    stream.close()


OnFrame = Callable[[int, bytes, float], None]  # Gets CAN-ID, data and time stamp (s) of a data frame.
Progress = Callable[[float], None]  # Gets the progress, 0..1.
ABSENT = (AbortCode.NO_OBJECT, AbortCode.NO_SUBINDEX)
# Abort codes of a server for a transfer that the request of another client has ended.
BROKEN = (AbortCode.TOGGLE, AbortCode.COMMAND, AbortCode.SEQUENCE_NUMBER, AbortCode.TIMEOUT)
ATTEMPTS = 6
# Objects that :meth:`NodeAccess.read_known` reads as REAL32.
REALS = frozenset(
    {
        od.ENCODER_CORNER_FREQUENCY,
        od.ENCODER_COSINE_CORNER_FREQUENCY,
        od.SUPERVISION_ACCELERATION,
        od.SUPERVISION_JERK,
        od.SUPERVISION_SYNC_JITTER,
        od.SUPERVISION_ANSWER_DELAY,
        od.FEEDBACK_VELOCITY,
        od.FEEDBACK_ACCELERATION,
        od.SECOND_TOLERANCE,
        od.SECOND_DIFFERENCE,
    }
)
REAL32 = struct.Struct("<f")
SETTLE_S = 0.05  # time until all frames of an aborted block transfer have arrived


class CommissioningError(CanfbError):
    """A step failed."""


class RefusedError(CommissioningError):
    """The node refused an SDO access; ``code``: abort code."""

    def __init__(self, text: str, code: int = AbortCode.GENERAL) -> None:
        super().__init__(text)
        self.code = code


class ObjectAbsentError(RefusedError):
    """The node does not have the object."""


@contextlib.contextmanager
def but_then(done: str) -> Iterator[None]:
    """What fails within, or is interrupted, says what was ``done`` before."""
    try:
        yield
    except (CanfbError, KeyboardInterrupt) as error:
        raise CommissioningError(f"done: {done}; but then {str(error) or 'interrupted'}") from error


class Master(Protocol):
    """A bus, see :class:`canfb.bus.bus_master.BusMaster`."""

    def sdo(self, node_id: int) -> Client:
        """SDO client for a node."""

    def subscribe(self, can_id: int, on_frame: OnFrame) -> None:
        """Call ``on_frame`` with CAN-ID, data, time stamp (s)."""

    def unsubscribe(self, can_id: int, on_frame: OnFrame) -> None:
        """End a subscription."""

    def send(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Send a data frame, or a remote frame."""

    def now(self) -> float:
        """Seconds, monotonic."""

    def wait(self, duration_s: float) -> None:
        """Wait."""


class Unchanged:
    """Measures for how long a value has not changed."""

    def __init__(self, master: Master, value: int | None = None) -> None:
        self._master = master
        self._value, self._since_s = value, master.now()

    def seconds(self, value: int) -> float:
        now = self._master.now()
        if value != self._value:
            self._value, self._since_s = value, now
        return now - self._since_s


@contextlib.contextmanager
def subscribed(master: Master, callbacks: Iterable[tuple[int, OnFrame]]) -> Iterator[None]:
    with contextlib.ExitStack() as stack:
        for can_id, on_frame in callbacks:
            master.subscribe(can_id, on_frame)
            stack.callback(master.unsubscribe, can_id, on_frame)
        yield


@contextlib.contextmanager
def received(master: Master, can_id: int) -> Iterator[list[bytes]]:
    """The data of each frame with this CAN-ID received meanwhile."""
    frames: list[bytes] = []
    with subscribed(master, [(can_id, lambda can_id, data, at: frames.append(bytes(data)))]):
        yield frames


class NodeAccess:
    """Objects of one node by SDO. CommissioningError for failures."""

    def __init__(self, master: Master, node_id: int, name: str) -> None:
        if node_id > cob.NODE_ID:
            raise CommissioningError(
                f"the {name} has no node-ID yet: assign one by LSS, and name that NODE beside --config"
            )
        self.master = master
        self.node_id = node_id
        self.name = f"{name} {node_id} ({node_id:02X}h)"

    def read(self, index: int, subindex: int, layout: str) -> int | float:
        """A number; ``layout`` as in struct."""
        data = self.read_bytes(index, subindex)
        size = struct.calcsize(f"<{layout}")
        if len(data) < size:
            raise CommissioningError(
                f"{self.name}: {index:04X}:{subindex:02X} has {len(data)} bytes, not {size}"
            )
        value: int | float = struct.unpack_from(f"<{layout}", data)[0]
        return value

    def integer(self, index: int, subindex: int, layout: str) -> int:
        return int(self.read(index, subindex, layout))

    def integer_if_there(self, place: od.Multiplexer, layout: str) -> int | None:
        """An integer; None if it is missing or the node does not answer."""
        try:
            return self.integer(*place, layout)
        except CommissioningError:
            return None

    def read_known(self, place: od.Multiplexer) -> int | float | None:
        """A number; None if refused."""
        try:
            data = self.read_bytes(*place)
        except RefusedError:
            return None
        if place in REALS and len(data) == REAL32.size:
            return float(REAL32.unpack(data)[0])
        return int.from_bytes(data, "little")

    def write(self, index: int, subindex: int, layout: str, value: float) -> None:
        self.write_bytes(index, subindex, struct.pack(f"<{layout}", value))

    def write_bytes(
        self, index: int, subindex: int, data: bytes, answer_within_s: float | None = None
    ) -> None:
        def send(client: Client) -> bytes:
            usual = client.RESPONSE_TIMEOUT
            client.RESPONSE_TIMEOUT = max(usual, answer_within_s or 0.0)
            try:
                return _store(client, index, subindex, data, False)
            finally:
                client.RESPONSE_TIMEOUT = usual

        self._transfer("writing", index, subindex, send)

    def read_bytes(self, index: int, subindex: int) -> bytes:
        return self._transfer("reading", index, subindex, lambda client: client.upload(index, subindex))

    def upload_domain(self, index: int, subindex: int, progress: Progress = lambda part: None) -> bytes:
        """Upload by block transfer, else segmented; ``progress`` gets 0..1."""
        return self._by_blocks(
            "reading", index, subindex, lambda client, block: _fetch(client, index, subindex, block, progress)
        )

    def download_domain(self, index: int, subindex: int, data: bytes) -> None:
        self._by_blocks(
            "writing", index, subindex, lambda client, block: _store(client, index, subindex, data, block)
        )

    def _by_blocks(
        self, doing: str, index: int, subindex: int, act: Callable[[Client, bool], bytes]
    ) -> bytes:
        """Block transfer; segmented if that fails: some servers lack it."""
        try:
            return self._transfer(doing, index, subindex, lambda client: act(client, True))
        except ObjectAbsentError:
            raise
        except CommissioningError:
            self.master.wait(SETTLE_S)
        return self._transfer(doing, index, subindex, lambda client: act(client, False))

    def _transfer(self, doing: str, index: int, subindex: int, act: Callable[[Client], bytes]) -> bytes:
        what = f"{self.name}: {doing} {index:04X}:{subindex:02X}"
        for attempt in itertools.count(1):
            client = self.master.sdo(self.node_id)
            try:
                with client.turn():
                    client.disturbed = False
                    return act(client)
            except (SdoError, can.CanError, OSError, AttributeError, RuntimeError, struct.error) as error:
                refused = isinstance(error, SdoAbortedError) and error.code not in BROKEN
                if attempt == ATTEMPTS or not client.disturbed or refused:
                    raise self._failed(what, error) from error
            self.master.wait(SETTLE_S * attempt)
        raise AssertionError("unreachable")

    def _failed(self, what: str, error: Exception) -> CommissioningError:
        if isinstance(error, SdoAbortedError):
            kind = ObjectAbsentError if error.code in ABSENT else RefusedError
            return kind(f"{what} is refused: {error}", error.code)
        if isinstance(error, SdoError):
            self.master.wait(0.0)  # raises BusError if the bus has failed
            said = str(error).rstrip(".")
            if said == "No SDO response received":
                said = (
                    "no answer; is the node on the bus, and is the bit rate right? A STOPPED node answers no "
                    f"SDO: canfb node preop {self.node_id:#04x} (canfb node list shows who is there)"
                )
            return CommissioningError(f"{what}: {said}")
        if isinstance(error, (can.CanError, OSError)):
            return CommissioningError(f"{what}: {reason(error)}")
        # Exceptions of canopen's streams after an unexpected answer.
        return CommissioningError(f"{what}: the response is invalid ({error})")


def as_real32(value: float) -> float:
    """``value`` rounded to REAL32, or infinity."""
    return ctypes.c_float(value).value


HEARTBEAT_TIME, GUARD_TIME = od.Multiplexer(0x1017), od.Multiplexer(0x100C)
LATE = 1.5  # periods to wait for a heartbeat, or for a response to another master
ANSWER_S = 0.1
ASKED = 3  # number of remote frames sent, as one may be lost
STEP_S = 0.005
STATES = {int(state): state for state in NmtState} | {0: NmtState.PRE_OPERATIONAL}


def state_in(data: bytes) -> NmtState | None:
    """The state in a frame 700h + id, or None; PRE-OPERATIONAL for a boot-up."""
    return STATES.get(data[0] & 0x7F) if len(data) == 1 else None


def nmt_state(node: NodeAccess) -> NmtState:
    """The NMT state by heartbeat (1017h), guarding (100Ch) or remote frame; CommissioningError if unknown."""
    heartbeat_s = node.integer(*HEARTBEAT_TIME, "H") / 1000
    with received(node.master, cob.ERROR_CONTROL + node.node_id) as heard:
        period_s = heartbeat_s or node.integer(*GUARD_TIME, "H") / 1000
        _wait_until(node.master, LATE * period_s, lambda: heard)
        for _ in range(0 if heartbeat_s else ASKED):
            if not heard:
                node.master.send(cob.ERROR_CONTROL + node.node_id, b"", remote=True)
                _wait_until(node.master, ANSWER_S, lambda: heard)
    states = [state for data in heard if (state := state_in(data)) is not None]
    if states:
        return states[-1]
    raise CommissioningError(
        f"{node.name}: its NMT state is not known: neither a heartbeat nor a response to node guarding "
        f"({cob.ERROR_CONTROL + node.node_id:03X}h) is heard"
    )


@contextlib.contextmanager
def without_restart(node: NodeAccess) -> Iterator[Callable[[], None]]:
    """CommissioningError at the end if the node has restarted; yields the check."""

    def check() -> None:
        if cob.BOOT_UP in heard:
            raise CommissioningError(f"{node.name} was restarted meanwhile (boot-up heard)")

    with received(node.master, cob.ERROR_CONTROL + node.node_id) as heard:
        yield check
    check()


def _wait_until(master: Master, within_s: float, holds: Callable[[], object]) -> bool:
    end = master.now() + within_s
    while not (held := bool(holds())) and master.now() < end:
        master.wait(STEP_S)
    return held


LEAST_SAMPLES = 100  # samples of a look if the position is valid; motion of 0.0002 cycle per sample shows
PATIENCE_S = 2.0  # longest wait for the next sample
LARGEST_SPREAD_CYCLES = 0.02  # of the phase at standstill: noise, and a drive that controls its position
BOOT_UP_S = 5.0  # longest time from reset to boot-up, and from start to a valid position
UNITS = 65536.0


@dataclass(frozen=True)
class MachineLook:
    """Motion before a reset: range of the phase in cycles, number of samples, cycles counted."""

    spread_cycles: float
    samples: int
    counted_cycles: int

    @property
    def moves(self) -> bool:
        return self.spread_cycles > LARGEST_SPREAD_CYCLES or self.counted_cycles != 0

    @property
    def text(self) -> str:
        if self.counted_cycles:
            return f"it has moved by {self.counted_cycles:+d} cycles in {self.samples} samples"
        return f"its phase spreads over {self.spread_cycles:.3f} cycle in {self.samples} samples"


def watch_standstill(module: NodeAccess, progress: Progress) -> MachineLook:
    seen: dict[int, float] = {}  # raw phases by sample number
    counts: list[int] = []
    known = module.integer(*od.FEEDBACK_STATUS, "H") & od.StatusBit.VALID
    least = LEAST_SAMPLES if known else STILL_SAMPLES  # with a lost position only the phase can show motion
    newest = Unchanged(module.master, 0)
    while len(seen) < least and newest.seconds(len(seen)) < PATIENCE_S:
        number = module.integer(*od.FEEDBACK_SAMPLES, "I")
        if number not in seen:
            status = module.integer(*od.FEEDBACK_STATUS, "H")
            phase = module.integer(*od.FEEDBACK_RAW_PHASE, "H") / UNITS
            if status & od.StatusBit.VALID:
                counts.append(module.integer(*od.FEEDBACK_CYCLE_COUNT, "q"))
            if not status & od.StatusBit.MISSED:
                seen[number] = phase
        progress(len(seen) / least)
        # A slow SYNC is not asked for more often than it brings something.
        module.master.wait(max(STEP_S, newest.seconds(len(seen)) / 2.0))
    if len(seen) < least:
        raise CommissioningError(
            f"{module.name}: {len(seen)} samples, then none for {PATIENCE_S:g} s, so it is not known "
            "whether the machine stands still: SYNC, encoder interface and module must run (canfb node "
            "start). --force resets it anyway"
        )
    first, *_ = seen.values()
    off = [apart(phase, first) for phase in seen.values()]
    # One cycle more or less may be noise of a phase near 0.
    moved = counts[-1] - counts[0] if counts else 0
    return MachineLook(max(off) - min(off), len(seen), moved if abs(moved) > 1 else 0)


def reset_nodes(
    master: Master, nodes: Sequence[int], command: NmtCommand, progress: Progress, *, force: bool = False
) -> list[dict[str, Any]]:
    """Reset nodes; CommissioningError, and no reset, if the machine of a module among them moves.

    A single module is then started, and must become valid. ``force``: skip the check of motion. Returns what
    was done, for JSON.
    """
    found = [NodeAccess(master, node, "node") for node in nodes]
    modules = (
        []
        if force and len(found) > 1
        else [one for one in found if one.read_known(od.FEEDBACK_STATUS) is not None]
    )
    if len(found) == len(modules) == 1:
        return [reset_module(modules[0], command, progress, force=force)]
    for n, module in enumerate(() if force else modules):
        _refuse_motion(module, progress, n, len(modules))
    for node in found:
        master.send(cob.NMT, struct.pack("BB", command, node.node_id))
    return [
        {"node": node.node_id, "forced": force, "spread_cycles": None, "position": None} for node in found
    ]


def _refuse_motion(module: NodeAccess, progress: Progress, before: int, of: int) -> None:
    look = watch_standstill(module, lambda part: progress((before + part) / of))
    if look.moves:
        raise CommissioningError(
            f"{module.name}: the machine moves, {look.text}: not reset. A start in motion may count wrong; "
            "stop the machine first. --force resets it anyway"
        )


def reset_module(
    module: NodeAccess, command: NmtCommand, progress: Progress, *, force: bool = False
) -> dict[str, Any]:
    """Reset a module at standstill, start it, and wait until its position is valid.

    ``force``: skip the check of motion. CommissioningError if it moves, or the position stays invalid.
    """
    if not force:
        _refuse_motion(module, progress, 0, 2)
    master, node = module.master, module.node_id
    with received(master, cob.ERROR_CONTROL + node) as heard:
        master.send(cob.NMT, struct.pack("BB", command, node))
        with but_then(f"the reset of {module.name} is sent"):
            if not _wait_until(master, BOOT_UP_S, lambda: cob.BOOT_UP in heard):
                raise CommissioningError(f"no boot-up within {BOOT_UP_S:g} s")
            master.send(cob.NMT, struct.pack("BB", NmtCommand.START, node))
    with but_then(f"{module.name} is reset and started"):
        _wait_until(master, BOOT_UP_S, lambda: module.integer(*od.FEEDBACK_STATUS, "H") & od.StatusBit.VALID)
        status = module.integer(*od.FEEDBACK_STATUS, "H")
        valid = status & od.StatusBit.VALID
        after = (
            watch_standstill(module, lambda part: progress((1 + part) / 2)) if valid and not force else None
        )
    if not valid:
        words = ", ".join([str(od.position_state(status)), *od.fault_words(status)])
        raise CommissioningError(
            f"{module.name}: reset and started, but its position is {words}: canfb why {module.node_id:#04x} "
            "says why"
        )
    if after is not None and after.moves:
        raise CommissioningError(
            f"{module.name}: the machine began to move while it was reset, {after.text}: its count may be "
            "wrong. Stop the machine, and reset it again"
        )
    return {
        "node": module.node_id,
        "forced": force,
        "spread_cycles": None if after is None else after.spread_cycles,
        "position": str(od.position_state(status)),
    }
