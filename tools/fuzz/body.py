"""Play an input of the fuzzer to a device, and check what must hold for any frames from the bus.

The checks: nothing raises; a device sends only what its NMT state allows, with its own CAN-IDs, and at most a
few frames at a time; an SDO server answers as CiA 301 defines; the deadline is not in the past; values are
within their limits, and PDO mappings would be accepted again; at the end the SDO server serves the next
client.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from typing import NamedTuple

from canfb import FeedbackModule, Frame, ModuleConfig, Sample
from canfb.cia301 import cob
from canfb.cia301.codes import NmtState, SdoAbort
from canfb.cia301.datatypes import DataType
from canfb.device.lss import UNCONFIGURED
from canfb.device.nmt_slave import COMMUNICATING
from canfb.device.od.dictionary import Entry
from canfb.device.pdo.mapping import COMMUNICATION, MAPPING, Direction, numbers, resolve_all
from canfb.device.storage.storage import MemoryStore
from canfb.interface.encoder_interface import EncoderInterface
from tools.fuzz.inputs import CONTENTS, LSS, NODE_ID, SERVER, Input, Step
from tools.fuzz.sdo import Broken, Follower, SdoWatcher, demand

Device = FeedbackModule | EncoderInterface

QUIET = frozenset({NmtState.INITIALISING, NmtState.STOPPED})
ERROR_CONTROL, LSS_ANSWER, FIRST_ANSWER = 0x700, 0x7E4, 0x580
TPDOS, EMERGENCY, SYNC = tuple((index, 1) for index in range(0x1800, 0x1804)), (0x1014, 0), (0x1005, 0)
SECOND_CHANNEL = (0x1201, 1), (0x1201, 2)
UNSTARTED, SAVING, DAMAGED = 0x80, 0x40, 0x20
"""Bits of the device of an input: the frames come before the power is on; the device has a store, and is
switched off and on at the end; what it saved is damaged meanwhile."""
NEVER: frozenset[NmtState] = frozenset()
_ABSENT = Entry(0, 0, DataType.UNSIGNED32, default=cob.NOT_VALID)
MOST_FRAMES = 160
"""Sent in one call: a block of an SDO upload, and what else may be due."""
MOST_TICKS = 50
BLOCK_S = 0.05  # time for a block of an upload, shorter than the SDO time-out
LIVE_LIMITS = frozenset({0x1003})
"""Objects whose limits say what may be written, not what may be read."""


class Turning:
    """Samples of a turning encoder; every 7th is lost."""

    def __init__(self) -> None:
        self._count = itertools.count()

    def next(self) -> Sample | None:
        count = next(self._count)
        return None if count % 7 == 6 else Sample(count * 300 % 4096 - 2048, count * 500 % 4096 - 2048)


def make(choice: int, store: MemoryStore | None = None) -> Device:
    """One of the devices: the module, the module with autostart, the encoder interface."""
    if choice % 3 == 2:
        return EncoderInterface(NODE_ID, Turning(), store=store)
    return FeedbackModule(ModuleConfig(node_id=NODE_ID, autostart=choice % 3 == 1), store)


class Services(NamedTuple):
    """Frames that a device may send: NMT states in which it may, by CAN-ID; answers of its SDO servers."""

    ids: dict[int, frozenset[NmtState]]
    answer: int
    second: tuple[int, int] | None  # CAN-IDs of request and answer of the second server, if it exists

    @staticmethod
    @lru_cache(maxsize=1024)
    def of(node_id: int, *cob_ids: int) -> Services:
        """Services of a node-ID, given the values of TPDOS, EMERGENCY, SYNC and SECOND_CHANNEL."""
        everywhere, operational = frozenset(COMMUNICATING), frozenset({NmtState.OPERATIONAL})
        *tpdos, emergency, sync, request, answer = cob_ids
        both = cob.is_valid(request) and cob.is_valid(answer)
        second = (request & cob.CAN_ID, answer & cob.CAN_ID) if both else None
        ids = {LSS_ANSWER: frozenset(NmtState)}
        if node_id != UNCONFIGURED:
            ids[ERROR_CONTROL + node_id] = frozenset(NmtState)
            ids |= {value & cob.CAN_ID: operational for value in tpdos if cob.is_valid(value)}
            ids |= {value & cob.CAN_ID: everywhere for value in [emergency] if cob.is_valid(value)}
            ids |= {value & cob.CAN_ID: everywhere for value in [sync] if value & cob.GENERATE}
        return Services(ids, FIRST_ANSWER + node_id, second)


class Play:
    def __init__(self, device: Device) -> None:
        self.device = device
        self.dictionary = device.dictionary
        self.now = 0.0
        self.received = 0
        """Frames so far."""
        self._first, self._second = SdoWatcher(), SdoWatcher()
        self._client = Follower()
        places = (*TPDOS, EMERGENCY, SYNC, *SECOND_CHANNEL)
        self._cob_ids = [self.dictionary.find(*place) or _ABSENT for place in places]

    @property
    def node_id(self) -> int:
        """The present node-ID, which LSS may change."""
        return self.device.node_id

    def start(self) -> None:
        sent = self.device.start(self.now)
        demand(any(map(self._is_boot_up, sent)) or self.node_id == UNCONFIGURED, "no boot-up")
        self._check_deadline()

    def receive(self, frame: Frame) -> list[Frame]:
        state, may = self.device.state, self._services()
        if state in COMMUNICATING and not frame.rtr:
            if frame.can_id == 0x600 + self.node_id:
                self._first.request(frame.data)
            if may.second is not None and frame.can_id == may.second[0]:
                self._second.request(frame.data)
        self.received += 1
        sent = self.device.receive(frame, self.now)
        self._check_sent(sent, state, may)
        return sent

    def tick(self) -> None:
        state, may = self.device.state, self._services()
        self._first.waiting()
        self._second.waiting()
        self._check_sent(self.device.tick(self.now), state, may)
        self._check_deadline()

    def wait(self, pause_s: float, *, punctual: bool) -> None:
        """Wait; tick at the end and, if punctual, also when due, at most MOST_TICKS times."""
        end = self.now + pause_s
        for _ in range(MOST_TICKS if punctual else 0):
            due = self.device.deadline()
            if due is None or due > end:
                break
            self.now = max(self.now, due)
            self.tick()
        self.now = max(self.now, end)
        self.tick()

    def do(self, step: Step) -> None:
        for frame in step.frames:
            self.receive(self._addressed(frame))
        self.wait(step.pause_s, punctual=step.punctual)
        self._client.content, self._client.spoil = CONTENTS[step.content], step.spoil
        for _ in range(step.follow):
            requests = self._client.requests()
            for request in requests:
                self.receive(self._addressed(Frame(SERVER, request)))
            self.wait(BLOCK_S if requests else 0.0, punctual=True)

    def _addressed(self, frame: Frame) -> Frame:
        """A frame of an input for NODE_ID, readdressed to the present node-ID of the device."""
        if frame.can_id == SERVER:
            node_id = self.node_id
            changed = node_id not in (NODE_ID, UNCONFIGURED)
            return frame._replace(can_id=0x600 + node_id) if changed else frame
        if frame.can_id == 0x000 and frame.data[1:] == bytes([NODE_ID]):
            return frame._replace(data=bytes([frame.data[0], self.node_id]))
        return frame

    def _check_deadline(self) -> None:
        due = self.device.deadline()
        demand(due is None or due > self.now, f"deadline {due} is not after {self.now}")

    def _is_boot_up(self, frame: Frame) -> bool:
        return frame.can_id == ERROR_CONTROL + self.node_id and frame.data == b"\x00"

    def _services(self) -> Services:
        return Services.of(self.node_id, *[entry.value for entry in self._cob_ids])

    def _check_sent(self, sent: list[Frame], before: NmtState, may_before: Services) -> None:
        after, may_after = self.device.state, self._services()
        if not sent and after is before and may_after is may_before and after not in QUIET:
            return
        demand(len(sent) <= MOST_FRAMES, f"{len(sent)} frames at once")
        reset = any(map(self._is_boot_up, sent))
        states = {before, after} | (set(NmtState) if reset else set())
        seconds = [may.second[1] for may in (may_before, may_after) if may.second is not None]
        for frame in sent:
            if not 0 < frame.can_id <= 0x7FF or len(frame.data) > 8:
                raise Broken(f"impossible frame {frame}")
            if frame.rtr and frame.can_id <= 0x700:
                raise Broken(f"a remote frame {frame}")
            may = may_before.ids.get(frame.can_id, NEVER) | may_after.ids.get(frame.can_id, NEVER)
            if frame.can_id in (may_before.answer, may_after.answer):
                demand(states & COMMUNICATING, f"an SDO answer in {before.name}")
                self._first.answer(frame.data)
                self._client.heard(frame.data)
            elif not may and frame.can_id in seconds:
                demand(states & COMMUNICATING, f"an SDO answer in {before.name}")
                self._second.answer(frame.data)
            elif not may & states:
                raise Broken(f"{frame} in {before.name}, which has no such service")
        if after in QUIET or reset:
            self._first.reset()
        if after in QUIET or reset or may_before.second != may_after.second:
            self._second.reset()

    def check_values(self) -> None:
        """Check that every value fits its type and limits, and every mapping in force would be accepted."""
        for entry in self.dictionary:
            if entry.on_read is None and entry.index not in LIVE_LIMITS:
                entry.check_limits(entry.value)
            with suppress(SdoAbort):  # a live value may be unavailable
                entry.encode()
        for direction in Direction:
            for number in numbers(self.dictionary, direction):
                communication = COMMUNICATION[direction] + number - 1
                mapping = MAPPING[direction] + number - 1
                cob_id, kind, count = (
                    int(self.dictionary.entry(*place).value)
                    for place in ((communication, 1), (communication, 2), (mapping, 0))
                )
                demand(not cob_id & 0x3FFFF800, f"{communication:04X}h:01 = {cob_id:08X}h")
                valid = cob.is_valid(cob_id) and cob.is_restricted(cob_id & cob.CAN_ID)
                demand(not valid, f"{communication:04X}h:01 = {cob_id:08X}h is restricted")
                demand(kind <= 240 or kind >= 252, f"{communication:04X}h:02 = {kind}")
                values = [self.dictionary.entry(mapping, sub).value for sub in range(1, count + 1)]
                resolve_all(self.dictionary, [int(value) for value in values], direction)

    def check_alive(self) -> None:
        """Check that the next client is served: after a second of silence, in PRE-OPERATIONAL."""
        self.wait(3.0, punctual=False)
        if self.node_id == UNCONFIGURED:
            for request in (b"\x04\x01", bytes([0x11, NODE_ID]), b"\x04\x00"):
                self.receive(Frame(LSS, request.ljust(8, b"\x00")))
            demand(self.node_id != UNCONFIGURED, "LSS gives no node-ID")
        self.receive(self._addressed(Frame(0x000, bytes([128, NODE_ID]))))
        demand(
            self.device.state is NmtState.PRE_OPERATIONAL,
            f"NMT does not lead out of {self.device.state.name}",
        )
        self.wait(3.0, punctual=False)
        sent = self.receive(self._addressed(Frame(SERVER, b"\x40\x00\x10\x00" + bytes(4))))
        answers = [frame.data[:4] for frame in sent if frame.can_id == self._services().answer]
        demand(answers == [b"\x43\x00\x10\x00"], f"1000h is answered by {answers}")


def play(given: Input) -> int:
    """Play one input, from power-on to the last check; returns the number of frames. Raises findings."""
    choice = given.device
    store = MemoryStore() if choice & SAVING else None
    received = _played(make(choice, store), given.steps, unstarted=bool(choice & UNSTARTED))
    if store is None:
        return received
    if choice & DAMAGED:
        damage(store, given.place, given.change)
    return received + _played(make(choice, store))


def _played(device: Device, steps: Sequence[Step] = (), *, unstarted: bool = False) -> int:
    run = Play(device)
    if not unstarted:
        run.start()
    for step in steps:
        run.do(step)
    if unstarted:
        run.start()
    run.check_values()
    run.check_alive()
    return run.received


def damage(store: MemoryStore, place: int, change: int) -> None:
    for group, image in store.images.items():
        at = place % (len(image) + 1)
        store.images[group] = image[:at] + bytes([change]) + image[at + (change & 1) :]
