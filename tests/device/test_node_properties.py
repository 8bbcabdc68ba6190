"""The node against a model: whatever comes in whatever order, it stays in the states that CiA 301 has."""

from copy import deepcopy
from functools import partial

from device_kit import ID, Bench, RecordingApplication, hexes
from hypothesis import given, strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from canfb import Frame, eds_path
from canfb.cia301 import cob
from canfb.cia301.codes import NmtState
from canfb.device.node import Node
from canfb.device.od.dictionary import Dictionary
from drawing import examples
from tools.fuzz.body import Play

PRISTINE = Dictionary.load(eds_path("canfb-module"), ID)
ERROR_CONTROL = 0x700 + ID
SERVER = 0x600 + ID
LSS_REQUEST, LSS_RESPONSE = 0x7E5, 0x7E4
STATES = {1: NmtState.OPERATIONAL, 2: NmtState.STOPPED, 128: NmtState.PRE_OPERATIONAL}
TALKING = (NmtState.PRE_OPERATIONAL, NmtState.OPERATIONAL)
RESTRICTED = [(0x000, 0x07F), (0x101, 0x180), (0x581, 0x5FF), (0x601, 0x67F), (0x6E0, 0x6FF), (0x701, 0x7FF)]
BIT_31, BIT_30 = 1 << 31, 1 << 30

# Writes that lead somewhere: (index, sub-index, bytes): values.
WRITES: dict[tuple[int, int, int], list[int]] = {
    (0x1003, 0, 1): [0, 1],
    (0x1005, 0, 4): [0x80, 0x40000080, 0x81, 0x40000081, 0x7F],
    (0x1006, 0, 4): [0, 1, 1000, 50_000],
    (0x1007, 0, 4): [0, 1, 10_000],
    (0x100C, 0, 2): [0, 1, 30, 65535],
    (0x100D, 0, 1): [0, 1, 3],
    (0x1012, 0, 4): [0x100, 0x80000100, 0x200, 0x80000200, 0x40000100],
    (0x1014, 0, 4): [0xA0, 0x800000A0, 0x220, 0x80000220, 0x7FF],
    (0x1015, 0, 2): [0, 1, 500],
    (0x1016, 1, 4): [0, 0x00470010, 0x00470100, 0x00480010, 0x01000000],
    (0x1016, 2, 4): [0, 0x00470010, 0x00480020, 0x00FF0010],
    (0x1017, 0, 2): [0, 0, 1, 20, 1000],
    (0x1019, 0, 1): [0, 1, 2, 10, 240, 241],
    (0x1029, 1, 1): [0, 1, 2, 3],
    (0x1201, 1, 4): [0x80000000, 0x6C0, 0x800006C0, 0x6D0, 0x601],
    (0x1201, 2, 4): [0x80000000, 0x6C1, 0x800006C1, 0x581],
    (0x1400, 1, 4): [0x190, 0x80000190, 0x80000191, 0x191],
    (0x1400, 2, 1): [0, 1, 240, 241, 252, 254, 255],
    (0x1400, 5, 2): [0, 5, 100],
    (0x1600, 0, 1): [0, 1, 2, 8, 9],
    (0x1600, 1, 4): [0x20000110, 0x00050008, 0x20000620, 0x20110110],
    (0x1800, 1, 4): [0x1A0, 0x400001A0, 0x800001A0, 0xC00001A0, 0x1A1],
    (0x1800, 2, 1): [0, 1, 3, 240, 241, 252, 253, 254, 255],
    (0x1800, 3, 2): [0, 1, 100],
    (0x1800, 5, 2): [0, 1, 40],
    (0x1800, 6, 1): [0, 1, 240, 241],
    (0x1A00, 0, 1): [0, 1, 3],
    (0x1A00, 1, 4): [0x20110110, 0x10010008, 0x60040020, 0x20000110],
    (0x1F80, 0, 4): [0, 4, 1, 8, 0xFFFFFFFF],
}
writes = st.sampled_from(sorted(WRITES)).flatmap(
    lambda place: st.tuples(st.just(place), st.sampled_from(WRITES[place]))
)
pauses = st.sampled_from([0.0, 0.0001, 0.001, 0.004, 0.03, 0.2, 3.0])


def value_of(dictionary: Dictionary, index: int, subindex: int = 0) -> int:
    return int(dictionary.entry(index, subindex).value)


def may_send(node: Node) -> set[int]:
    """The CAN-IDs that CiA 301 allows in this state, with these parameters."""
    allowed = {ERROR_CONTROL, LSS_RESPONSE}
    if node.state in TALKING:
        allowed |= {0x580 + ID, value_of(node.dictionary, 0x1201, 2) & cob.CAN_ID}
        allowed |= {value_of(node.dictionary, index) & cob.CAN_ID for index in (0x1005, 0x1014)}
    if node.state is NmtState.OPERATIONAL:
        tpdos = range(0x1800, 0x1804)
        allowed |= {value_of(node.dictionary, index, 1) & cob.CAN_ID for index in tpdos}
    return allowed


class NodeModel(RuleBasedStateMachine):
    """Keeps what the NMT state and the toggle bit must be, and looks at all that is sent."""

    def __init__(self) -> None:
        super().__init__()
        self.node = Node(deepcopy(PRISTINE), ID)
        self.autostart = False
        self.now = 0.0
        self.state = NmtState.INITIALISING
        self.toggle = 0

    def state_changed(self, old: NmtState, new: NmtState, now: float, why: str) -> None:
        assert old is not new
        assert now == self.now

    def call(self, frame: Frame | None) -> list[Frame]:
        """One call of the node; what it sent is allowed by the state before it or after it."""
        node = self.node
        allowed = may_send(node)
        sent = node.tick(self.now) if frame is None else node.receive(frame, self.now)
        allowed |= may_send(node)
        for one in sent:
            assert one.can_id in allowed, (one, node.state)
            assert 0 <= len(one.data) <= 8
            assert not one.rtr
        return sent

    def take_over_errors(self, before: int) -> None:
        """A communication error may have led to another state, as 1029h has it."""
        reaction = {0: NmtState.PRE_OPERATIONAL, 1: self.state, 2: NmtState.STOPPED}[before]
        if self.node.state is not self.state:
            assert self.node.state is reaction
            assert self.state is not NmtState.STOPPED
            assert before == 2 or self.state is NmtState.OPERATIONAL
        self.state = self.node.state

    @initialize(autostart=st.booleans())
    def start(self, autostart: bool) -> None:
        application = RecordingApplication()
        self.node = Node(deepcopy(PRISTINE), ID, application, autostart=autostart)
        application.react(
            state_changed=self.state_changed, rpdo_received=lambda number, now: self.node.trigger_tpdo(1, now)
        )
        assert self.node.receive(Frame(0, bytes([1, ID])), self.now) == []
        assert self.node.start(self.now) == [Frame(ERROR_CONTROL, b"\x00")]
        self.state = NmtState.OPERATIONAL if autostart else NmtState.PRE_OPERATIONAL
        self.autostart = autostart

    @rule(command=st.sampled_from([1, 1, 1, 2, 128]), node_id=st.sampled_from([0, ID]))
    def nmt(self, command: int, node_id: int) -> None:
        self.call(Frame(0, bytes([command, node_id])))
        self.state = STATES[command]

    @rule(command=st.sampled_from([129, 130]))
    def reset(self, command: int) -> None:
        sent = self.call(Frame(0, bytes([command, ID])))
        assert sent == [Frame(ERROR_CONTROL, b"\x00")]
        self.state = NmtState.OPERATIONAL if self.autostart else NmtState.PRE_OPERATIONAL
        self.toggle = 0
        assert value_of(self.node.dictionary, 0x1001) == 0

    @rule(data=st.binary(max_size=8))
    def no_nmt(self, data: bytes) -> None:
        if len(data) != 2 or data[1] not in (0, ID):
            assert self.call(Frame(0, data)) == []

    @rule(write=writes)
    def write(self, write: tuple[tuple[int, int, int], int]) -> None:
        (index, subindex, size), value = write
        head = bytes([0x23 | (4 - size) << 2, index & 0xFF, index >> 8, subindex])
        before = value_of(self.node.dictionary, index, subindex)
        sent = self.call(Frame(SERVER, head + value.to_bytes(4, "little")))
        answers = [frame.data for frame in sent if frame.can_id == 0x580 + ID]
        after = value_of(self.node.dictionary, index, subindex)
        if self.state not in TALKING:
            assert sent == []
            assert after == before
        elif answers[0][0] == 0x80:
            assert after == before
        else:
            assert answers == [b"\x60" + head[1:] + bytes(4)]
            assert after == value
            if index == 0x1017 and value:
                self.toggle = 0

    @rule(data=st.binary(min_size=8, max_size=8))
    def anything_by_sdo(self, data: bytes) -> None:
        if not (data[0] >> 5 in (1, 6) or data[0] < 0x20):  # reads, mistakes and aborts
            self.call(Frame(SERVER, data))

    @rule()
    def guard(self) -> None:
        heartbeat = value_of(self.node.dictionary, 0x1017)
        sent = self.call(Frame(ERROR_CONTROL, b"", rtr=True))
        if heartbeat:
            assert sent == []
        else:
            assert sent[0] == Frame(ERROR_CONTROL, bytes([self.toggle | self.state]))
            assert {frame.can_id for frame in sent[1:]} <= may_send(self.node) - {ERROR_CONTROL}
            self.toggle ^= 0x80

    @rule(
        can_id=st.sampled_from([0x080, 0x081, 0x100, 0x190, 0x191, 0x747, 0x748]),
        data=st.sampled_from([b"", b"\x01", b"\x05", bytes(4), bytes(6), bytes(8), bytes(9)]),
    )
    def meant_for_a_service(self, can_id: int, data: bytes) -> None:
        behaviour = value_of(self.node.dictionary, 0x1029, 1)
        self.call(Frame(can_id, data))
        self.take_over_errors(behaviour)

    @rule(can_id=st.integers(1, 0x7FF), data=st.binary(max_size=9), rtr=st.booleans())
    def anything_else(self, can_id: int, data: bytes, rtr: bool) -> None:
        """Not to the servers, node guarding and LSS, which have their own rules."""
        servers = {SERVER, value_of(self.node.dictionary, 0x1201, 1) & cob.CAN_ID}
        if can_id not in servers | {ERROR_CONTROL, LSS_REQUEST}:
            self.call(Frame(can_id, data, rtr))

    @rule(command=st.sampled_from([0x04, 0x5A, 0x5E, 0x4C, 0x51, 0x11]), value=st.integers(0, 2))
    def by_lss(self, command: int, value: int) -> None:
        """In every state, without a change of it; a new node-ID is refused or waits for a reset."""
        if command != 0x11 or value == 0:  # 0 is not a node-ID
            sent = self.call(Frame(LSS_REQUEST, bytes([command, value, *bytes(6)])))
            assert {frame.can_id for frame in sent} <= {LSS_RESPONSE}
            assert all(len(frame.data) == 8 for frame in sent)

    @rule(number=st.integers(1, 4))
    def event(self, number: int) -> None:
        self.node.trigger_tpdo(number, self.now)
        self.call(None)

    @rule(code=st.sampled_from([0x7300, 0x6310]), comes=st.booleans())
    def error(self, code: int, comes: bool) -> None:
        if comes:
            self.node.emergency(code, 0x20, b"\x01\x02", self.now)
            assert value_of(self.node.dictionary, 0x1001) & 0x21 == 0x21
        else:
            self.node.clear_emergency(code, self.now)
        self.call(None)

    @rule(pause=pauses)
    def time_passes(self, pause: float) -> None:
        """From deadline to deadline; after some of them the host is late."""
        end = self.now + pause
        behaviour = value_of(self.node.dictionary, 0x1029, 1)
        for _ in range(20):
            due = self.node.deadline()
            if due is None or due > end:
                break
            self.now = max(self.now, due)
            self.call(None)
            self.take_over_errors(behaviour)
        self.now = end
        self.call(None)
        self.take_over_errors(behaviour)

    @invariant()
    def the_state_is_that_of_the_model(self) -> None:
        assert self.node.state is self.state

    @invariant()
    def the_next_deadline_lies_ahead(self) -> None:
        self.call(None)
        due = self.node.deadline()
        assert due is None or due > self.now

    @invariant()
    def parameters_are_in_their_ranges(self) -> None:
        """What CiA 301 says, apart from the code that checks it."""
        value = partial(value_of, self.node.dictionary)
        off_31 = [(0x1014, 0), (0x1201, 1), (0x1201, 2), (0x1400, 1), (0x1401, 1)]
        off_31 += [(0x1800 + number, 1) for number in range(4)]
        used = [value(0x1005), value(0x1012)]
        used += [value(*place) for place in off_31 if not value(*place) & BIT_31]
        for cob_id in used:
            assert not cob_id & 0x3FFFF800
            assert not any(first <= cob_id & 0x7FF <= last for first, last in RESTRICTED)
        assert value(0x1019) == 0 or 2 <= value(0x1019) <= 240
        assert value(0x1029, 1) in (0, 1, 2)
        assert value(0x1F80) in (0, 4)
        assert not value(0x1012) & BIT_30
        assert value(0x1800, 6) <= 240
        assert value(0x1800, 2) not in (0xFC, 0xFD) or value(0x1800, 1) & (BIT_31 | BIT_30) != BIT_30
        watched = [value(0x1016, sub) for sub in range(1, 5)]
        nodes = [one >> 16 for one in watched if one & 0xFFFF and 1 <= one >> 16 <= 127]
        assert len(nodes) == len(set(nodes))

    @invariant()
    def values_and_pdos_are_possible(self) -> None:
        Play(self.node).check_values()  # type: ignore[arg-type]

    @invariant()
    def the_error_register_fits_the_errors(self) -> None:
        register = value_of(self.node.dictionary, 0x1001)
        assert not register & ~0x31
        assert bool(register) == bool(register & 0x01)
        assert value_of(self.node.dictionary, 0x1003) <= 8


TestNodeModel = NodeModel.TestCase
TestNodeModel.settings = examples(60, stateful_step_count=60)


# Another node with the same node-ID: it is noticed by any frame that only this node may send.

OWN = {0x0A0, 0x1A0, 0x2A0, 0x5A0, 0x720}
"""Of the module with its defaults: EMCY, two TPDOs, SDO answers, boot-up and heartbeat."""


def emergency(can_id: int, at: int = 0x0A0) -> list[str]:
    return [f"{at:03X}#508111{can_id & 0xFF:02X}{can_id >> 8:02X}000000"]


any_frame = st.builds(
    Frame,
    st.integers(0, 0x7FF) | st.sampled_from([*sorted(OWN), 0x3A0, 0x190, 0x6C1]),
    st.binary(max_size=8),
    st.booleans() | st.just(False),
)
cob_ids = st.sampled_from(
    [
        (0x1014, 0, [0x0A0, 0x800000A0, 0x080, 0x190]),
        (0x1201, 1, [0x6C0, 0x800006C0, 0x190]),
        (0x1201, 2, [0x6C1, 0x800006C1, 0x190]),
        (0x1400, 1, [0x190, 0x80000190, 0x1A0, 0x800001A0]),
        (0x1800, 1, [0x400001A0, 0x800001A0, 0x190, 0x400006C0]),
        (0x1802, 1, [0x400003A0, 0xC00003A0, 0x080, 0x400001A0]),
    ]
).flatmap(lambda row: st.tuples(st.just(row[:2]), st.sampled_from(row[2])))


def expected_own(dictionary: Dictionary) -> set[int]:
    """The same from the objects alone: valid COB-IDs of what it sends, without those of what it hears."""

    def valid(index: int, subindex: int = 1) -> set[int]:
        value = dictionary.entry(index, subindex).value
        return set() if value & 1 << 31 else {value & 0x7FF}

    second = valid(0x1201, 1) and valid(0x1201, 2)
    sent = valid(0x1014, 0) | {0x5A0} | (valid(0x1201, 2) if second else set())
    for index in range(0x1800, 0x1804):
        sent |= valid(index)
    heard = {0x080, 0x620} | valid(0x1400) | valid(0x1401) | (valid(0x1201, 1) if second else set())
    return sent - heard | {0x720}


@examples(150)
@given(
    changes=st.lists(cob_ids, max_size=8),
    command=st.sampled_from([1, 2, 128]),
    frames=st.lists(any_frame, max_size=30),
    reset=st.sampled_from([129, 130]),
)
def test_whatever_comes_own_can_ids_are_counted_and_the_first_is_told(
    changes: list[tuple[tuple[int, int], int]], command: int, frames: list[Frame], reset: int
) -> None:
    """The state stays, and a reset forgets it."""
    bench = Bench(deepcopy(PRISTINE))
    bench.start()
    for (index, subindex), value in changes:
        bench.write(index, subindex, value, 4)
    bench.nmt(command)
    own = expected_own(bench.dictionary)
    assert bench.node.own_can_ids == own
    first, counted, told = None, 0, list[Frame]()
    for frame in frames:
        if frame.can_id in (0x000, 0x620, 0x7E5, 0x6C0, 0x190):
            continue  # commands, and what may be a request of the second SDO client, change things
        if frame.can_id in own and not frame.rtr:
            counted += 1
            first = frame.can_id if first is None else first
        told += [one for one in bench.node.receive(frame, 0.0) if one.data[:2] == b"\x50\x81"]
        assert bench.node.state is STATES[command]
    assert bench.node.counters.duplicate_frames == counted
    assert bench.application.told("duplicate_received") == ([] if first is None else [(first, 0.0)])
    emcy = bench.dictionary.entry(0x1014).value
    heard = first is not None and command != 2 and not emcy >> 31
    assert hexes(told) == (emergency(first or 0, emcy) if heard else [])
    assert bench.nmt(reset) == ["720#00"]
    assert bench.read(0x1001) == 0
    assert bench.send(0x5A0, bytes(8)) == emergency(0x5A0)
    assert bench.read(0x1003, 1) == 0x5A0 << 16 | 0x8150
