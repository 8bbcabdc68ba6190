"""The configuration of a module, loaded into others: whatever they held before, they are that module then."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import replace

import pytest
from configuration_kit import NODE_ID, PROGRAMS, played, put, reset, run, state, table, write
from hypothesis import example, given
from module_bench import Bench

from canfb.device.od.writes import Write, decode_concise, encode_concise
from canfb.module.device_configuration import DeviceConfiguration, configuration_of, configuration_read
from canfb.module.feedback_module import FeedbackModule
from canfb.module.module_config import ModuleConfig, SecondPositionConfig
from canfb.objects import StatusBit
from canfb.signal.conditioning import Conditioning
from drawing import examples

SIXTEEN_BITS = [write(0x2001, 2, 2, 32768), write(0x2001, 4, 2, 40960), write(0x2001, 3, 2, 6554)]
NARROW = [write(0x2001, 3, 2, 1), write(0x2001, 4, 2, 2)]
WATCHING = [write(0x1016, sub, 4, sub << 16 | 100) for sub in (1, 2)]
WATCHING_OTHERWISE = [write(0x1016, sub, 4, (3 - sub) << 16 | 100) for sub in (1, 2)]
COUNTING = [write(0x1019, 0, 1, 10), write(0x1006, 0, 4, 1000), write(0x1005, 0, 4, 0x40000080)]
MOVED_EMCY = [write(0x1014, 0, 4, 1 << 31), write(0x1014, 0, 4, 0x90)]


@pytest.fixture(scope="module")
def modules() -> tuple[FeedbackModule, FeedbackModule]:
    """Two of them, as delivered; every example resets both."""
    return FeedbackModule(ModuleConfig(node_id=NODE_ID)), FeedbackModule(ModuleConfig(node_id=NODE_ID))


def begun(modules: tuple[FeedbackModule, FeedbackModule], *programs: list[Write]) -> Iterator[FeedbackModule]:
    for module, program in zip(modules, programs, strict=True):
        reset(module)
        run(module, program)
        yield module


@given(PROGRAMS, PROGRAMS)
@example(SIXTEEN_BITS, [])
@example([], SIXTEEN_BITS)
@example(NARROW, SIXTEEN_BITS)
@example(SIXTEEN_BITS, NARROW)
@example(WATCHING, WATCHING_OTHERWISE)
@example(COUNTING, [])
@example([], COUNTING)
@example([*COUNTING[:2], write(0x1005, 0, 4, 0x40000090)], COUNTING)
@example([*COUNTING, *MOVED_EMCY], [write(0x1014, 0, 4, 0xA1)])
@examples(150)
def test_the_writes_are_taken_whatever_the_module_held_and_make_it_the_same(
    modules: tuple[FeedbackModule, FeedbackModule], wanted: list[Write], before: list[Write]
) -> None:
    source, target = begun(modules, wanted, before)
    configuration = configuration_of(source)
    refused = [(one, code) for one in configuration.writes() if (code := put(target, one))]
    assert refused == []
    assert state(target) == state(source)
    assert configuration_of(target).writes() == configuration.writes()


@given(PROGRAMS)
@examples(50)
def test_a_module_that_was_loaded_answers_the_same_frames_with_the_same_frames(
    modules: tuple[FeedbackModule, FeedbackModule], wanted: list[Write]
) -> None:
    source, target = begun(modules, wanted, [])
    for one in configuration_of(source).writes():
        assert put(target, one) == 0
    # Both begin here: what was sent and cleared while they were written is another matter.
    for module in modules:
        module.tick(0.0)
    assert played(target) == played(source)


def test_a_good_configuration_is_heard_of_at_all(modules: tuple[FeedbackModule, FeedbackModule]) -> None:
    """The comparison above would pass for two silent modules."""
    reset(modules[0])
    sent = {frame.can_id for frame in played(modules[0])}
    assert {0x1A0, 0x2A0} <= sent


@pytest.mark.parametrize("fields", [
    {},
    {"adc_bits": 16, "cycles_per_revolution": 1024, "coast_samples": 7, "frozen_samples": 3},
    {"times": True},
    {"adc_bits": 14, "conditioning": Conditioning(12.5, -3.25, 1.07, 0.93, 0.021)},
    {"residual_limit": 0.25, "max_acceleration_rad_s2": 1234.5, "autostart": True, "encoder_interface": 17},
    {"second_position": SecondPositionConfig(increments=4096, revolutions=3, reversed=True, cob_id=0x1B0,
                                             tolerance_revolutions=0.01, invalidates=True, before_bytes=3)},
])  # fmt: skip
def test_a_module_of_a_configuration_and_one_that_was_loaded(fields: dict[str, object]) -> None:
    source = FeedbackModule(ModuleConfig(node_id=NODE_ID, **fields))  # type: ignore[arg-type]
    target = FeedbackModule(ModuleConfig(node_id=NODE_ID))
    source.start(0.0)
    target.start(0.0)
    for one in configuration_of(source).writes():
        assert put(target, one) == 0
    assert state(target) == state(source)
    assert configuration_of(source).refused_in_index_order() == []


def test_over_the_bus_with_a_table_from_bytes() -> None:
    """A master that knows nothing but the concise DCF: SDO writes in Pre-operational, one after the other."""
    source = FeedbackModule(ModuleConfig(node_id=NODE_ID, conditioning=Conditioning(phase_error_rad=0.25)))
    source.start(0.0)
    wanted = table(100, 0.02)
    run(source, [Write(0x2020, 1, wanted.to_bytes()), write(0x2020, 3, 4, wanted.crc32)])
    bench = Bench()
    for one in decode_concise(encode_concise(configuration_of(source).writes())):
        bench.sdo.download(one.index, one.subindex, one.data)
    assert bench.module.chain.correction.table == wanted
    assert bench.module.chain.correction.conditioning == Conditioning(phase_error_rad=0.25)
    assert state(bench.module) == state(source)
    read = configuration_read(
        NODE_ID, lambda entry: bench.module.dictionary.entry(entry.index, entry.subindex).value, 0,
        bench.sdo.upload(0x2020, 1),
    )  # fmt: skip
    assert read.writes() == configuration_of(source).writes()
    assert read.table_crc32 == wanted.crc32 == zlib.crc32(wanted.to_bytes())


def test_commands_and_the_preset_are_no_part_of_it(modules: tuple[FeedbackModule, FeedbackModule]) -> None:
    reset(modules[0])
    configuration = configuration_of(modules[0])
    indices = {index for index, _ in configuration.values()}
    assert not indices & {0x1003, 0x1010, 0x1011, 0x2000, 0x2030, 0x2050, 0x6003, 0x6009, 0x6200, 0x6509}
    assert {0x1005, 0x1017, 0x1400, 0x1A03, 0x2001, 0x2002, 0x2010, 0x6000, 0x6301} <= indices
    assert all(
        modules[0].dictionary.entry(one.index, one.subindex).access in ("rw", "wo")
        for one in configuration.writes()
    )


def test_what_changes_with_the_table(modules: tuple[FeedbackModule, FeedbackModule]) -> None:
    reset(modules[0])
    plain = configuration_of(modules[0])
    assert plain.values()[0x2020, 3] == 0
    assert (0x2020, 1) not in plain.values()
    data = table(16, 0.01).to_bytes()
    with_table = replace(plain, table=data)
    assert with_table.values()[0x2020, 1] == data
    assert (0x2020, 1) not in with_table.values(with_table=False)
    assert with_table.values(with_table=False)[0x2020, 3] == zlib.crc32(data)
    places = [(one.index, one.subindex) for one in with_table.writes()]
    assert places.index((0x2002, 5)) < places.index((0x2020, 1)) < places.index((0x2020, 3))
    assert places[-2:] == [(0x1020, 1), (0x1020, 2)]


@pytest.mark.parametrize(("program", "refused"), [
    (COUNTING, [(0x1019, 0)]),
    (MOVED_EMCY, [(0x1014, 0)]),
    (SIXTEEN_BITS, []),
    ([write(0x1006, 0, 4, 1000)], []),
])  # fmt: skip
def test_what_a_master_cannot_write_in_the_order_of_the_indices(
    modules: tuple[FeedbackModule, FeedbackModule], program: list[Write], refused: list[tuple[int, int]]
) -> None:
    reset(modules[0])
    run(modules[0], program)
    configuration: DeviceConfiguration = configuration_of(modules[0])
    assert configuration.refused_in_index_order() == refused


def test_the_lower_amplitude_may_pass_the_upper_one_of_another_full_scale(
    modules: tuple[FeedbackModule, FeedbackModule],
) -> None:
    """In the order of the sub-indices; until the upper one is written no amplitude is accepted."""
    module = modules[0]
    reset(module)
    assert put(module, write(0x2001, 3, 2, 2560)) == 0x06090030
    assert put(module, write(0x2001, 2, 2, 32768)) == 0
    assert put(module, write(0x2001, 3, 2, 6554)) == 0
    assert put(module, write(0x2001, 4, 2, 6554)) == 0x06090030
    assert put(module, write(0x2001, 4, 2, 40960)) == 0
    assert put(module, write(0x2001, 3, 2, 40960)) == 0x06090030


def test_amplitudes_in_disorder_accept_nothing_and_are_loaded_as_they_are() -> None:
    bench = Bench()
    bench.start()
    assert bench.at(0.0)[1] & StatusBit.VALID
    for one in (write(0x2001, 2, 2, 32768), write(0x2001, 3, 2, 6554), write(0x2001, 2, 2, 2048)):
        assert put(bench.module, one) == 0
    assert bench.at(0.0)[1] & StatusBit.AMPLITUDE
    target = FeedbackModule(ModuleConfig(node_id=NODE_ID))
    target.start(0.0)
    assert not any(put(target, one) for one in configuration_of(bench.module).writes())
    assert state(target) == state(bench.module)
