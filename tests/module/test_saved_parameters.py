"""What `save` keeps of a module, over a reset and a power-off; docs/storage.md; the hours of 6508h."""

import errno
import re
from collections.abc import Mapping
from typing import Any

import canopen
import canopen.lss
import pytest
from canopen import RemoteNode
from hypothesis import example, given, strategies as st
from module_bench import Bench

from canfb import Conditioning, FeedbackModule, Frame, ModuleConfig, SecondPositionConfig, eds_path
from canfb.cia301 import cob
from canfb.demo.story import EmbeddedNetwork
from canfb.device.storage.kept import Identity, ParameterGroup, Record, decode_image, encode_image
from canfb.device.storage.storage import MemoryStore
from canfb.hosting import state_files
from canfb.interface.encoder_interface import EncoderInterface
from canfb.module.device_configuration import configuration_of
from canfb.simulation.embedded_bus import EmbeddedBus
from documentation import blocks, page
from drawing import examples
from ideal_tracks import wavy_table
from played import Still

MANUFACTURER = ParameterGroup.MANUFACTURER
IDENTITY = Identity(0, 1, 1)
TABLE = wavy_table()


@pytest.mark.parametrize("ended_by", ["save", "load"])
def test_a_bad_table_refuses_the_whole_group_and_raises_the_alarm_until(ended_by: str) -> None:
    store = MemoryStore()
    first = Bench(store)
    first.sdo[0x2010][3].raw = 9
    first.sdo[0x1017].raw = 0
    first.save()
    records = decode_image(store.images[MANUFACTURER], MANUFACTURER, IDENTITY)
    records = [one for one in records if (one.index, one.subindex) != (0x2020, 1)]
    records.append(Record(0x2020, 1, False, TABLE.to_bytes()[::-1]))
    store.images[MANUFACTURER] = encode_image(MANUFACTURER, IDENTITY, records)
    machine = Bench(store)
    assert machine.heard[0] == Frame(0x720, b"\x00")
    assert machine.alarms() == [(0x6310, 0x21, 4)]
    assert machine.sdo[0x6503].raw == 0x1000
    assert machine.sdo[0x6504].raw & 0x1000
    assert machine.sdo[0x1001].raw == 0x21
    assert machine.sdo[0x2010][3].raw == 3
    assert machine.module.chain.correction.table is None
    machine.remote.nmt.state = "OPERATIONAL"
    machine.sync()
    machine.counts(0, 1500)
    assert machine.sdo[0x2011][1].raw & 1  # it measures
    told: list[Mapping[ParameterGroup, str]] = []
    machine.module.on_parameter_faults = told.append
    for command in (0x81, 0x82):
        assert machine.sdo[0x6503].raw == 0x1000
        machine.remote.nmt.send_command(command)
    machine.activate(TABLE)
    getattr(machine, ended_by)()
    assert machine.alarms() == [*[(0x6310, 0x21, 4)] * 3, (0, 0, 0)]
    assert [list(faults) for faults in told] == [[MANUFACTURER], [MANUFACTURER], []]
    assert machine.sdo[0x6503].raw == 0
    assert machine.sdo[0x1001].raw == 0


def test_the_encoder_interface_keeps_its_communication_parameters() -> None:
    store = MemoryStore()
    bus = EmbeddedBus()
    network = EmbeddedNetwork(bus)
    master = canopen.RemoteNode(16, str(eds_path("encoder-interface")))
    network.add_node(master)
    bus.attach(EncoderInterface(16, Still(), store=store))
    master.sdo[0x1800][2].raw = 4
    master.sdo.download(0x1010, 1, b"save")
    assert set(store.images) == {ParameterGroup.COMMUNICATION}
    assert EncoderInterface(16, Still(), store=store).start(0.0) == [Frame(0x710, b"\x00")]
    master.sdo[0x1800][2].raw = 1
    master.nmt.send_command(0x82)
    assert master.sdo[0x1800][2].raw == 4
    store.images[ParameterGroup.COMMUNICATION] = b"?"
    frames = EncoderInterface(16, Still(), store=store).start(0.0)
    assert [frame.data.hex() for frame in frames] == ["00", "1063010200000000"]


def is_accepted(fields: dict[str, Any]) -> bool:
    """Its second position has no COB-ID of its own TPDOs."""
    second = fields.get("second_position")
    return second is None or second.cob_id not in [tpdo + fields.get("node_id", 32) for tpdo in cob.TPDOS]


configurations = st.fixed_dictionaries(
    {},
    optional={
        "node_id": st.integers(1, 15) | st.integers(17, 127),
        "encoder_interface": st.just(16),
        "cycles_per_revolution": st.integers(1, 1048576),
        "adc_bits": st.integers(4, 16),
        "residual_limit": st.floats(0.01, 0.5),
        "coast_samples": st.integers(0, 255),
        "frozen_samples": st.integers(0, 255),
        "coarse_limit_revolutions": st.floats(1e-6, 0.25),
        "max_acceleration_rad_s2": st.floats(0, 1e9),
        "conditioning": st.builds(
            Conditioning,
            *[st.floats(-50, 50)] * 2,
            *[st.floats(0.5, 2)] * 2,
            st.floats(-0.5, 0.5),
            *[st.floats(-1e-3, 1e-3)] * 2,
        ),
        "autostart": st.booleans(),
        "corner_hz": st.just(0.0) | st.floats(1e3, 1e6),
        "predict": st.integers(0, 2),
        "noise_margin": st.integers(0, 255),
        "second_position": st.builds(
            SecondPositionConfig,
            increments=st.integers(1, 2**32 - 1),
            revolutions=st.integers(1, 2**32 - 1),
            tolerance_revolutions=st.floats(0, 0.25, width=32),
            before_bytes=st.integers(0, 4),
            cob_id=st.none() | st.integers(0x181, 0x57F),
        ),
    },
).filter(is_accepted)


@examples(40)
@given(configurations, configurations)
def test_what_one_configuration_saves_another_restores(before: dict[str, Any], after: dict[str, Any]) -> None:
    store = MemoryStore()
    first = Bench(store, **before)
    first.save()
    second = Bench(store, **after)
    assert second.module.storage.faults == {}
    one, other = (configuration_of(machine.module) for machine in (first, second))
    differing = {place for place, value in one.values().items() if other.values()[place] != value}
    cob_ids = {(0x1014, 0), *((base + n, 1) for base in (0x1400, 0x1800) for n in range(4))}
    assert differing <= cob_ids, "that follow the node-ID"


def test_a_state_that_save_accepts_is_restored() -> None:
    """The lowest amplitude may pass the highest until that is written, too, for another full scale."""
    store = MemoryStore()
    one = Bench(store)
    one.sdo[0x2001][2].raw = 0x8000
    with pytest.raises(canopen.SdoAbortedError):  # no limit could lie above, and it could not be saved
        one.sdo[0x2001][3].raw = 0xFFFF
    one.sdo[0x2001][3].raw, one.sdo[0x2040][3].raw = 0xC00, 7
    one.sdo[0x1020][1].raw = 5
    one.sdo[0x2040][3].raw = 8
    assert one.sdo[0x1020][1].raw == 0, "a code is a parameter"
    one.save()
    restored = Bench(store)
    assert restored.module.storage.faults == {}
    assert [restored.sdo[0x2001][subindex].raw for subindex in (2, 3, 4)] == [0x8000, 0xC00, 0xC01]


@pytest.mark.parametrize("cob_id", [0x181, 0x190, 0x57F])
def test_a_cob_id_of_another_node_does_not_follow_the_node_id(cob_id: int) -> None:
    """That of the second encoder is of the configuration; saved by node 33 it is the same in node 32."""
    store = MemoryStore()
    second = SecondPositionConfig(increments=1, revolutions=1, cob_id=cob_id)
    Bench(store, node_id=33, second_position=second).save()
    restored = Bench(store).module
    assert restored.storage.faults == {}
    assert restored.dictionary.entry(0x1401, 1).value == cob_id


STORAGE, _, LSS = page("storage").partition("\n## Tables")[0].partition("\n## LSS")


def test_the_frames_of_saving_and_loading() -> None:
    module = FeedbackModule(ModuleConfig(node_id=32), MemoryStore())
    module.start(0.0)
    (commands,) = blocks(STORAGE, "sh")
    seen = []
    for can_id, data in re.findall(r"^cansend can0 ([0-9A-F]{3})#(\w+)", commands, re.M):
        answers = module.receive(Frame(int(can_id, 16), bytes.fromhex(data)), 0.0)
        seen.append((answers[0].data[:4].hex(), module.dictionary.entry(0x1017).value))
    assert seen == [("60171000", 500), ("60101001", 500), ("00", 500), ("60111001", 500), ("00", 0)]


def test_the_program_with_a_store_of_its_own() -> None:
    (program,) = blocks(STORAGE, "python")
    exec(program, {})


def test_the_master_that_sets_a_node_id(monkeypatch: pytest.MonkeyPatch) -> None:
    bus = EmbeddedBus()
    network = EmbeddedNetwork(bus)
    network.lss.RESPONSE_TIMEOUT = 0
    monkeypatch.setattr(canopen.lss.time, "sleep", lambda seconds: None)
    monkeypatch.setattr(network, "connect", lambda **words: network)
    monkeypatch.setattr(network, "disconnect", lambda: None)
    monkeypatch.setattr(canopen, "Network", lambda: network)
    store = MemoryStore()
    config = ModuleConfig(node_id=32, serial_number=4711)
    module = FeedbackModule(config, store)
    bus.attach(module)
    (program,) = blocks(LSS, "python")
    exec(program, {})
    assert module.node_id == 0x21
    assert FeedbackModule(config, store).start(0.0) == [Frame(0x721, b"\x00")]


def test_the_files_that_the_page_names_are_those_of_the_program() -> None:
    named = set(re.findall(r"`(\w+\.bin)`", STORAGE))
    assert named == {f"{group.name.lower()}.bin" for group in ParameterGroup} | {state_files.PENDING}


HOUR_S = 3600.0
OPERATING_TIME = ParameterGroup.OPERATING_TIME


class Module:
    """A module that is read at chosen times."""

    def __init__(self, store: MemoryStore, start_s: float = 0.0) -> None:
        self.module = FeedbackModule(ModuleConfig(node_id=32), store)
        self.start_frames = self.module.start(start_s)

    def nmt(self, command: int, now: float) -> None:
        self.module.receive(Frame(0, bytes([command, 32])), now)

    def read(self, now: float) -> int:
        (answer,) = self.module.receive(Frame(0x620, bytes.fromhex("4008650000000000")), now)
        assert answer.data[:4] == bytes.fromhex("43086500")
        return int.from_bytes(answer.data[4:], "little")


def test_without_a_store_nothing_is_counted(bench: Bench) -> None:
    remote: RemoteNode = bench.remote
    assert remote.sdo[0x6508].raw == 0xFFFFFFFF
    bench.module.end(9 * HOUR_S)


WAYS = {"stop": 2, "pre-operational": 128, "reset": 129, "end": None}


@examples(30)
@given(st.lists(st.tuples(st.sampled_from([*WAYS]), st.integers(0, 200), st.booleans()), max_size=6))
@example([(way, 20, True) for way in WAYS])
def test_tenths_of_an_hour_go_on_in_the_next_process(runs: list[tuple[str, int, bool]]) -> None:
    """However one ends, and whatever is loaded."""
    store, total = MemoryStore(), 0
    for n, (way, tenths, load) in enumerate(runs):
        start_s, end_s = 5e6 * n, 5e6 * n + 0.1 * HOUR_S * tenths
        module = Module(store, start_s)
        module.nmt(1, start_s)
        if load:
            module.module.receive(Frame(0x620, bytes.fromhex("231110016C6F6164")), start_s)
        total += tenths
        assert not tenths or module.read(end_s - 0.1) == total - 1
        assert module.read(end_s) == total
        command = WAYS[way]
        module.module.end(end_s) if command is None else module.nmt(command, end_s)
    assert Module(store).read(0.0) == total


class FullDisk(MemoryStore):
    full = True

    def save(self, changes: Mapping[ParameterGroup, bytes | None]) -> None:
        if self.full:
            raise OSError(errno.ENOSPC, "No space left on device")
        super().save(changes)


def test_a_full_disk_loses_nothing_that_can_be_written_later() -> None:
    store = FullDisk()
    module = Module(store)
    module.module.end(HOUR_S)
    store.full = False
    module.module.end(HOUR_S)
    assert Module(store).read(0.0) == 10


def test_a_damaged_time_is_told_and_counts_anew() -> None:
    store = MemoryStore()
    Module(store).module.end(HOUR_S)
    store.images[OPERATING_TIME] = store.images[OPERATING_TIME][:-1]
    module = Module(store)
    told = [frame.data[:4].hex() for frame in module.start_frames if frame.can_id == 0xA0]
    assert told == ["10632181"]  # EMCY 6310h, group 81h
    assert module.read(0.0) == 0
    module.module.end(HOUR_S)
    assert module.module.dictionary.entry(0x6503).value == 0
    assert Module(store).read(0.0) == 10
