"""A module that processes the frames of a log, in the time of the log.

As in the runner, it receives each frame at the time of its stamp, after deadlines that are due before, and
jobs are done between frames. It does not receive the frames of the recorded module; they are compared with
the frames that it sends now.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import islice, pairwise
from statistics import median

from canfb import objects as od
from canfb.cia301 import cob, datatypes
from canfb.cia301.codes import NmtCommand, NmtState
from canfb.cia301.frame import Frame
from canfb.device.lss import UNCONFIGURED
from canfb.device.od.dictionary import Dictionary
from canfb.device.storage.storage import Store
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig
from canfb.module.objects.calibrating import Outcome
from canfb.replay.findings import Block, FaultList, Margins, SampleColumns
from canfb.signal.correction import Correction
from canfb.view.module_view import place_of, valid_pdos, values_of

UPLOADED = (b"\x43", b"\x47", b"\x4b", b"\x4f")  # expedited, size indicated (CiA 301, 7.2.4.3.6)
LONGEST_DELAY_S = 1.0  # Longest time between a frame and its counterpart, s.


class OwnFrames:
    """Pairs recorded and replayed frames of one CAN-ID, in order; an equal frame that waits is preferred.

    equal, different   number of pairs
    only_recorded      frames of the log that the replay did not send
    only_replayed      frames of the replay that are not in the log
    first              first different pair: stamp of the log, seconds, recorded and replayed data
    uploads            objects whose values differ, read by expedited SDO transfers
    differences        fields of the frame (from ``fields`` at the first different pair), with statistics
    """

    def __init__(self, fields: Callable[[], list[FieldDifference]]) -> None:
        self.equal = self.different = self.only_recorded = self.only_replayed = 0
        self.first: tuple[float, bytes, bytes] | None = None
        self.uploads = set[str]()
        self.differences: list[FieldDifference] = []
        self._fields = fields
        self._replayed: deque[tuple[float, bytes]] = deque()
        self._recorded: deque[tuple[float, bytes]] = deque()

    def replayed(self, data: bytes, now: float) -> None:
        self.only_recorded += _drop_late(self._recorded, now)
        before = _taken(self._recorded, data)
        if before is not None:
            self.only_recorded += before
            self.equal += 1
        else:
            self.only_replayed += _drop_late(self._replayed, now)
            self._replayed.append((now, data))

    def recorded(self, data: bytes, now: float, stamp_s: float) -> None:
        waiting = self._replayed
        self.only_replayed += _drop_late(waiting, now)
        before = _taken(waiting, data)
        if before is not None:
            self.only_replayed += before
            self.equal += 1
        elif waiting:
            _, replayed = waiting.popleft()
            self.different += 1
            if self.first is None:
                self.first = (stamp_s, data, replayed)
                self.differences = self._fields()
            if data[:1] in UPLOADED and data[:4] == replayed[:4]:
                self.uploads.add(f"{data[2]:02X}{data[1]:02X}h:{data[3]:02X}")
            for one in self.differences:
                one.note(int.from_bytes(data, "little"), int.from_bytes(replayed, "little"))
        else:
            self.only_recorded += _drop_late(self._recorded, now)
            self._recorded.append((now, data))

    def close(self, now: float) -> None:
        self.only_replayed += _drop_late(self._replayed, now)
        self.only_recorded += len(self._recorded)


def _drop_late(waiting: deque[tuple[float, bytes]], now: float) -> int:
    number = len(waiting)
    while waiting and now - waiting[0][0] > LONGEST_DELAY_S:
        waiting.popleft()
    return number - len(waiting)


def _taken(waiting: deque[tuple[float, bytes]], data: bytes) -> int | None:
    """Remove the first equal frame and the n before it; returns n, None without an equal frame."""
    for place, (_, other) in enumerate(waiting):
        if other == data:
            for _ in range(place + 1):
                waiting.popleft()
            return place
    return None


@dataclass
class FieldDifference:
    """Replayed less recorded value of one object, over the pairs that differ; integers modulo their width."""

    name: str
    data_type: int
    first_bit: int
    bits: int
    pairs: int = 0
    least: float = math.inf
    most: float = -math.inf

    def note(self, recorded: int, replayed: int) -> None:
        one, other = (whole >> self.first_bit & (1 << self.bits) - 1 for whole in (recorded, replayed))
        if self.data_type in datatypes.FLOATS:
            values = [
                datatypes.decode(self.data_type, raw.to_bytes(self.bits // 8, "little"))
                for raw in (one, other)
            ]
            apart = 0.0 if one == other else float(values[1]) - float(values[0])
        else:
            half = 1 << (self.bits - 1)
            apart = float((other - one + half) % (2 * half) - half)
        self.pairs += bool(apart)
        self.least, self.most = min(self.least, apart), max(self.most, apart)


def pdo_fields(dictionary: Dictionary, can_id: int) -> list[FieldDifference]:
    """The fields of the TPDO with a CAN-ID as mapped now; none for other frames."""
    pdos = valid_pdos(values_of(dictionary.find), od.TPDO, od.TPDO_MAPPING)
    entries = [one for pdo in pdos if pdo.can_id == can_id for one in pdo.bits_of()]
    places = [place_of(entry) for entry, _ in entries]
    return [
        FieldDifference(
            f"{place.object_index:04X}h:{place.subindex:02X}",
            dictionary.assumed(*place).data_type,
            bit,
            entry & 0xFF,
        )
        for place, (entry, bit) in zip(places, entries, strict=True)
    ]


def _usual_wait_s(can_id: int, frames: Sequence[Frame]) -> float:
    waits = [
        (frame.timestamp or 0.0) - (before.timestamp or 0.0)
        for before, frame in pairwise(frames)
        if frame.can_id == can_id
    ]
    return max(0.0, median(waits)) if waits else 0.0


ASKED_FRAMES = 500  # frames after a step of the clock that are searched for the usual interval
# A longer silence is shortened to this: by then the module has lost everything that it can lose.
LONGEST_GAP_S = 60.0

HEAD_FRAMES = 20_000  # Frames at the beginning of a log that are searched for the NMT state.


class Begin(Enum):
    """NMT state at the beginning of a replay."""

    AUTO = "auto"
    BOOT_UP = "boot-up"
    PRE_OPERATIONAL = "pre-operational"
    OPERATIONAL = "operational"


def found_in(head: Iterable[Frame], node_id: int, own_can_ids: Collection[int]) -> Begin:
    """NMT state at the beginning, from the first frame that shows it.

    A boot-up: power-on at that frame. A PDO of its own, or a heartbeat with 05h: OPERATIONAL. Another
    heartbeat, or an NMT start: PRE-OPERATIONAL. None of these: OPERATIONAL, as there is no master.
    """
    error_control = cob.ERROR_CONTROL + node_id
    pdos = {can_id for can_id in own_can_ids if 0x180 < can_id < 0x580}
    for can_id, data, _, _ in (frame for frame in head if not frame.rtr):
        if can_id == error_control and len(data) == 1:
            if data == cob.BOOT_UP:
                return Begin.BOOT_UP
            return Begin.OPERATIONAL if data[0] & 0x7F == NmtState.OPERATIONAL else Begin.PRE_OPERATIONAL
        if can_id in pdos:
            return Begin.OPERATIONAL
        if can_id == 0 and data[:1] == bytes([NmtCommand.START]) and data[1:2] in (b"\0", bytes([node_id])):
            return Begin.PRE_OPERATIONAL
    return Begin.OPERATIONAL


POLL_S = 0.01  # interval of polling computations, as in the runner
EVERYBODY = frozenset({0x000, 0x100, 0x7E4, 0x7E5})  # NMT, TIME, LSS
_new = tuple.__new__  # makes a named tuple in half the time that its own constructor takes


class ModuleReplay:
    """One module of a log. :meth:`feed` it the frames in batches, then :meth:`close` it.

    ``correction`` is put in force at each start instead of the stored one. ``begin`` is the NMT state at
    the beginning; AUTO finds it in the first frames. ``takers`` get the samples in blocks, ``sent`` each
    frame that the module sends, with a stamp on the clock of the log.
    """

    def __init__(
        self,
        config: ModuleConfig,
        store: Store | None = None,
        *,
        correction: Correction | None = None,
        begin: Begin = Begin.AUTO,
        takers: Iterable[Callable[[Block], None]] = (),
        sent: Callable[[Frame], None] | None = None,
    ) -> None:
        self.module = FeedbackModule(config, store)
        self.frames = self.recorded_own = self.sent = self.emergencies = self.restarts = 0
        self.first_s = self.last_s = 0.0
        self.steps_back = self.gaps = self.bad_stamps = 0
        self.faults, self.margins = FaultList(), Margins(lambda: self.module.max_speed_rad_s)
        self._correction, self.begin, self._on_sent = correction, begin, sent
        self.samples = SampleColumns(
            self.module,
            [self.faults.take, self.margins.take, *takers],
            [self.margins.take],
        )
        self.module.on_feedback = self.samples.take
        self._own_frames: dict[int, OwnFrames] = {}
        self._head: list[Frame] | None = []
        self._on = False
        self._now = self._poll_s = 0.0
        self._boot_up_s = -LONGEST_DELAY_S
        self._routes_known = -1
        self._own = self._received_ids = frozenset[int]()
        self._emergency = self.module.dictionary.entry(*od.EMCY_COB_ID)

    @property
    def compared(self) -> dict[int, OwnFrames]:
        """Comparison by CAN-ID; empty if the log has no frame of the module."""
        return dict(sorted(self._own_frames.items())) if self.recorded_own else {}

    @property
    def own_can_ids(self) -> frozenset[int]:
        module = self.module
        sync = module.dictionary.entry(*od.SYNC_COB_ID).value & cob.CAN_ID
        return (module.own_can_ids | module.can_ids().data) - EVERYBODY - {sync}

    @property
    def emergency_id(self) -> int:
        return int(self._emergency.value & cob.CAN_ID)

    def feed(self, frames: list[Frame]) -> None:
        """Process the next frames of the log: ``timestamp`` in seconds, of any clock. No frame raises."""
        if self._head is None:
            self._take(frames)
        else:
            self._head += frames
            if len(self._head) >= HEAD_FRAMES:
                self._take(self._opened())

    def close(self) -> None:
        if self._head is not None:
            self._take(self._opened())
        if self._on:
            self._tick(self._now)
        self.samples.flush()
        for one in self._own_frames.values():
            one.close(self._now)
        self.module.end(self._now)

    def _opened(self) -> list[Frame]:
        head, self._head = self._head or [], None
        known = (one.timestamp for one in head if one.timestamp is not None and math.isfinite(one.timestamp))
        self.samples.origin_s = self.first_s = next(known, 0.0)
        node_id = self.module.node_id_at_power_on()
        if self.begin is Begin.AUTO:
            self.begin = found_in(islice(head, HEAD_FRAMES), node_id, self.module.own_can_ids)
        if self.begin is Begin.BOOT_UP:
            self._own = frozenset({cob.ERROR_CONTROL + node_id})
            return head
        self._power_on(self._now)
        if self.begin is Begin.OPERATIONAL and node_id != UNCONFIGURED:
            self._command(NmtCommand.START, self._now)
        self._own_frames.clear()  # frames of this start have no counterpart in the log
        self._look_round()
        return head

    def _power_on(self, now: float) -> None:
        self._on = True
        self._give_out(self.module.start(now), now)

    def _command(self, command: NmtCommand, now: float) -> None:
        frame = Frame(0, bytes((command, self.module.node_id)), False, now)
        self._give_out(self.module.receive(frame, now), now)

    def _take(self, batch: list[Frame]) -> None:
        """Pass frames to the module. Called for each frame: one that it does not receive must be cheap."""
        samples, module = self.samples, self.module
        receive, deadline = module.receive, module.deadline
        now, origin = self._now, samples.origin_s
        received_ids, own, poll_s = self._received_ids, self._own, self._poll_s
        for can_id, data, rtr, stamp in batch:
            received = (origin if stamp is None else stamp) - origin
            if now <= received <= now + LONGEST_GAP_S:
                now = received
            else:
                self._now = now
                received = now = self._judged(Frame(can_id, data, rtr, stamp), batch, now)
                origin = samples.origin_s
            if can_id in received_ids and not rtr:
                due = deadline()
                if due is not None and due < now:
                    self._tick(now)
                answers = receive(_new(Frame, (can_id, data, False, received)), now)
                if answers:
                    self._give_out(answers, now)
            elif can_id in own and not rtr:
                self._recorded(can_id, data, now)
            elif rtr and self._on:
                self._tick(now)
                self._give_out(receive(Frame(can_id, data, True, received), now), now)
            else:
                continue
            if now >= poll_s:
                poll_s = self._poll_s = now + POLL_S
                self._compute(now)
            if module.route_changes != self._routes_known:
                self._look_round()
                received_ids, own = self._received_ids, self._own
        self._now = now
        self.frames += len(batch)
        self.last_s = now + origin

    def _judged(self, frame: Frame, batch: list[Frame], now: float) -> float:
        """Time of a frame unless ``now <= stamp - origin_s <= now + LONGEST_GAP_S``.

        At a step back the clock was set, because the reader sorts late frames.
        """
        stamp_s = math.nan if frame.timestamp is None else frame.timestamp
        if not math.isfinite(stamp_s):
            self.bad_stamps += 1
            return now
        if stamp_s - self.samples.origin_s < now:
            self.steps_back += 1
            # Assume that the usual time before this CAN-ID has passed: with a shorter interval the position
            # of a fast machine could be valid and wrong by a cycle.
            now += _usual_wait_s(frame.can_id, batch[batch.index(frame) :][:ASKED_FRAMES])
        else:
            self.gaps += 1
            now += LONGEST_GAP_S
        self.samples.origin_s = stamp_s - now
        return now

    def _tick(self, now: float) -> None:
        """Do what is due before ``now``, each at its time; at equal time a frame comes first."""
        while (due := self.module.deadline()) is not None and due < now:
            self._give_out(self.module.tick(due), due)

    def _compute(self, now: float) -> None:
        """Run a pending job, which takes no time of the log."""
        job = self.module.pending_job() if self._on else None
        if job is None:
            return
        try:
            result: Outcome | Exception = job()
        except Exception as error:  # the measurement is refused
            result = error
        self._give_out(self.module.finish_job(job, result, now), now)

    def _look_round(self) -> None:
        if not self._on:
            return
        module = self.module
        self._routes_known = module.route_changes
        self._own, self._received_ids = module.own_can_ids, module.received_can_ids
        sync = module.dictionary.entry(*od.SYNC_COB_ID).value
        if sync & cob.GENERATE:
            self._own |= {sync & cob.CAN_ID}
            self._received_ids -= self._own

    def _recorded(self, can_id: int, data: bytes, now: float) -> None:
        self.recorded_own += 1
        if data == cob.BOOT_UP and can_id > cob.ERROR_CONTROL:
            self._booted_up(now)
        self._pairs(can_id).recorded(data, now, now + self.samples.origin_s)

    def _booted_up(self, now: float) -> None:
        """The recorded module has booted up; if no reset was commanded, it was switched off and on."""
        if not self._on:
            self._power_on(now)
        elif now - self._boot_up_s > LONGEST_DELAY_S:
            self._tick(now)
            self.restarts += 1
            self._command(NmtCommand.RESET_NODE, now)
            self.module.chain.restart()  # power-on: the position is unknown
        self._boot_up_s = -LONGEST_DELAY_S  # the boot-up of the replayed module has its counterpart

    def _pairs(self, can_id: int) -> OwnFrames:
        if can_id not in self._own_frames:
            self._own_frames[can_id] = OwnFrames(lambda: pdo_fields(self.module.dictionary, can_id))
        return self._own_frames[can_id]

    def _give_out(self, frames: list[Frame], now: float) -> None:
        self.sent += len(frames)
        for can_id, data, rtr, _ in frames:
            self.module.sent(can_id, now)
            self._pairs(can_id).replayed(data, now)
            if can_id == self.emergency_id:
                self.emergencies += 1
            elif data == cob.BOOT_UP and can_id > cob.ERROR_CONTROL:
                self._boot_up_s = now  # the replayed module has started: activate the table to be tested
                if self._correction is not None:
                    self.module.use_correction(self._correction)
            if self._on_sent is not None:
                self._on_sent(Frame(can_id, data, rtr, now + self.samples.origin_s))
