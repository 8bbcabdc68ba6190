"""What the monitor makes of the frames of real devices is what these devices hold; rate, jitter and load."""

import itertools
import json
import math
import random
import struct
import sys
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given, strategies as st

from canfb import Config, FeedbackModule, ModuleConfig, objects as od
from canfb.cia301.frame import Frame, frame_bits
from canfb.monitoring.bus_model import BusModel
from canfb.monitoring.layout import NEEDED, Origin, assumed_layout, known_layouts, layout_of
from canfb.monitoring.lines import residual_words, sync_words
from canfb.monitoring.module_model import Bins, SyncMeter
from canfb.monitoring.snapshot import ModuleSnapshot, NodeSnapshot
from canfb.view.module_view import samples_per_sync, values_of
from drawing import examples
from folding import each
from monitored_network import BIT_RATE, INTERFACE, NODE, MonitoredNetwork


@pytest.fixture(scope="module")
def turning() -> MonitoredNetwork:
    return MonitoredNetwork().run(2.0)


def nodes(network: MonitoredNetwork) -> dict[int, NodeSnapshot]:
    return {node.node_id: node for node in network.model.snapshot(network.bus.now).nodes}


def test_position_status_residual_and_tracks_are_those_of_the_module(turning: MonitoredNetwork) -> None:
    shown, dictionary = turning.module(), turning.modules[0].dictionary
    assert shown.position_units == dictionary.entry(*od.POSITION_VALUE).value
    per_revolution = dictionary.entry(*od.UNITS_PER_REVOLUTION).value
    assert shown.position_revolutions == pytest.approx(shown.position_units / per_revolution)
    assert shown.status == dictionary.entry(*od.FEEDBACK_STATUS).value
    assert (shown.position_state, shown.faults) == ("valid", [])
    assert shown.residual_cycles == dictionary.entry(*od.FEEDBACK_RESIDUAL).value / 65536
    assert shown.residual_limit_cycles == pytest.approx(1 / 3, abs=1e-4)
    peaks = [one for one in shown.residual_history_cycles if one is not None]
    assert len(peaks) == 4
    assert shown.residual_peak_cycles is not None
    assert shown.residual_cycles is not None
    assert max(peaks) >= shown.residual_peak_cycles >= shown.residual_cycles > 0.0
    last = [frame for frame, _ in turning.frames if frame.can_id == 0x180 + INTERFACE][-1]
    assert shown.tracks_counts[-1] == struct.unpack("<hh", last.data)
    assert shown.amplitude_is_raw
    assert shown.amplitude_counts == pytest.approx(math.hypot(*shown.tracks_counts[-1]))
    low, high = shown.amplitude_limits_counts
    assert low < math.hypot(*shown.tracks_counts[-1]) < high


@each(
    "step_s, seconds, revolutions, rev_s",
    [  # Backwards over the end of the range and over a preset; stopped 0.6 s ago, at slow PDOs, too.
        (0.005, 0.3, lambda at: 0.05 - 3.0 * at + 1.5 * (at >= 0.2), -3.0),
        *((step_s, 5.0, lambda at: 3.0 * min(at, 4.4), 0.0) for step_s in (0.125, 0.05, 0.02)),
    ],
)
def test_the_velocity_of_the_last_positions(
    step_s: float, seconds: float, revolutions: Callable[[float], float], rev_s: float
) -> None:
    (layout,) = known_layouts(Config(), [NODE])
    model = BusModel([layout])
    for k in range(round(seconds / step_s)):
        position = round(layout.units_per_revolution * revolutions(k * step_s)) % layout.total_range
        model.receive(Frame(0x180 + NODE, struct.pack("<IHH", position, 1, 0)), k * step_s)
    ((_, shown),) = model.snapshot().modules
    assert shown.velocity_rad_s == pytest.approx(2.0 * math.pi * rev_s, rel=1e-3)


def test_faults_are_counted_as_the_module_counts_them() -> None:
    network = MonitoredNetwork().run(1.5)
    assert nodes(network)[NODE].emergencies == []
    network.source.lost = True
    network.run(0.02)
    shown, dictionary = network.module(), network.modules[0].dictionary
    assert shown.position_state == "lost"
    assert "sample missed" in shown.faults
    assert shown.since_fault_s is not None
    assert shown.since_fault_s < 0.02
    assert shown.seen["lost"] == dictionary.entry(*od.COUNTER_LOST).value == 1
    # Once it is lost, it publishes only what is new.
    assert 0 < shown.seen["missed"] <= dictionary.entry(*od.COUNTER_MISSED).value
    last = nodes(network)[NODE].emergencies[0]
    assert (last.code, last.text) == (0x7300, "sensor: position not valid")
    assert last.age_s < 0.02
    assert not any(shown.counters.values()), "not read: it only listens"


def test_nmt_states_are_followed(turning: MonitoredNetwork) -> None:
    network = MonitoredNetwork().run(0.0009)
    assert nodes(network)[NODE].state == "PRE-OPERATIONAL", "the boot-up"
    network.run(0.1)
    assert (nodes(network)[NODE].state, nodes(network)[NODE].state_source) == ("OPERATIONAL", "PDO")
    network.bus.send(Frame(0x000, bytes((2, NODE))))
    waited = next(frame for frame, _ in reversed(network.frames) if frame.can_id == 0x180 + NODE)
    network.model.receive(waited, network.bus.now)
    assert (nodes(network)[NODE].state, nodes(network)[NODE].state_source) == ("STOPPED", "command")
    network.modules[0].dictionary.entry(0x1017).download(struct.pack("<H", 50))
    network.run(0.2)
    assert (nodes(network)[NODE].state, nodes(network)[NODE].state_source) == ("STOPPED", "heartbeat")
    assert network.module().age_s == pytest.approx(0.2, abs=0.02)
    network.bus.send(Frame(0x000, bytes((129, 0))))
    assert nodes(network)[NODE].boot_ups == 2
    assert nodes(network)[INTERFACE].module is None, "that is no module"


def test_an_adc_pdo_of_eight_bytes_is_no_position() -> None:
    model = BusModel()
    for k in range(1000):
        angle = 0.7 * k
        data = struct.pack("<hhI", round(1500 * math.sin(angle)), round(1500 * math.cos(angle)), k * 9973)
        model.receive(Frame(0x190, data), k * 1e-3)
    assert model.snapshot().modules == []


def test_named_nodes_that_are_not_there_are_shown_as_such() -> None:
    network = MonitoredNetwork(known=(NODE,), only_known=True)
    network.model.learn(assumed_layout(5))
    network.run(0.1)
    shown = nodes(network)
    assert sorted(shown) == [5, NODE], "the interface was not asked for"
    assert shown[5].heard_s is None


@each("operating", [0, 1, 4])  # 6000h: forwards, backwards, scaled
def test_a_mapping_of_the_module_is_followed(operating: int) -> None:
    """2011:05 and 2011:07 in a TPDO3 of another COB-ID: amplitude and velocity are those of the module."""
    network = MonitoredNetwork()
    dictionary = network.modules[0].dictionary
    for place, layout, value in (
        (od.OPERATING_PARAMETERS, "H", operating), (od.UNITS_PER_REVOLUTION, "I", 36_000),
        ((0x1A02, 0), "B", 0), ((0x1A02, 1), "I", od.FEEDBACK_AMPLITUDE.mapped(16)),
        ((0x1A02, 2), "I", od.FEEDBACK_VELOCITY.mapped(32)), ((0x1A02, 0), "B", 2),
        ((0x1802, 2), "B", 254), ((0x1802, 1), "I", 0x3F5),
    ):  # fmt: skip
        dictionary.entry(*place).download(struct.pack(f"<{layout}", value))
    network.model.learn(layout_of(NODE, values_of(dictionary.find), Origin.MODULE))
    network.run(1.5)
    shown = network.module()
    assert 0x3F5 in {frame.can_id for frame, _ in network.frames}
    assert not shown.amplitude_is_raw
    assert shown.amplitude_counts == dictionary.entry(*od.FEEDBACK_AMPLITUDE).current()
    speed = dictionary.entry(*od.FEEDBACK_VELOCITY).current() * (-1.0 if operating == 1 else 1.0)
    assert shown.velocity_rad_s == pytest.approx(speed, rel=1e-6)
    units = 36_000 if operating == 4 else dictionary.entry(*od.SINGLE_TURN_RESOLUTION).current()
    assert shown.position_revolutions == pytest.approx((shown.position_units or 0) / units)
    assert shown.layout == "module"
    assert shown.assumed == []


@pytest.mark.parametrize("missing", [None, *(place for places in NEEDED.values() for place in places)])
def test_what_could_not_be_read_is_assumed(missing: od.Multiplexer | None) -> None:
    dictionary = MonitoredNetwork().modules[0].dictionary
    read = values_of(lambda *place: None if place == missing else dictionary.find(*place))
    layout = layout_of(NODE, read, Origin.MODULE)
    assert layout.assumed == {name for name, places in NEEDED.items() if missing in places}
    for origin in (Origin.DEFAULT, Origin.CONFIGURATION, Origin.ASSUMED):
        assert layout_of(NODE, read, origin).assumed == set(NEEDED)


def test_a_limit_by_noise_that_was_not_read_is_assumed() -> None:
    network = MonitoredNetwork()
    network.modules[0].dictionary.entry(*od.SUPERVISION_NOISE_MARGIN).download(b"\x06")
    dictionary = network.modules[0].dictionary
    module = network.model.learn(layout_of(NODE, values_of(dictionary.find), Origin.MODULE))
    network.run(0.2)
    assert network.module().assumed == ["residual_limit_cycles"]
    module.put(od.FEEDBACK_NOISE, 100, network.bus.now)
    assert network.module().assumed == []


def test_the_snapshot_is_json(turning: MonitoredNetwork) -> None:
    plain = turning.model.snapshot(turning.bus.now).to_json()
    assert json.loads(json.dumps(plain, allow_nan=False)) == plain
    assert plain["nodes"][1]["module"]["position_state"] == "valid"


FRAMES = st.lists(
    st.tuples(
        st.one_of(
            st.integers(-5, 0x900),
            st.sampled_from([0, 0x80, 0xA0, 0x190, 0x1A0, 0x2A0, 0x5A0, 0x700, 0x720, 0x7A0]),
        ),
        st.binary(max_size=64),
        st.booleans(),
        st.one_of(st.floats(-10.0, 10.0), st.sampled_from([0.0, 1e-3, 1e9])),
    ),
    max_size=60,
)


@examples(150)
@given(FRAMES)
def test_no_frame_raises(frames: list[tuple[int, bytes, bool, float]]) -> None:
    model = BusModel(known_layouts(Config(), [NODE]), 500_000)
    now = 0.0
    for can_id, data, rtr, step in frames:
        now += step
        model.receive(Frame(can_id, data, rtr), now)
        model.receive(Frame(0x8000_0123, data), now)  # of 29 bits
        json.dumps(model.snapshot(now).to_json(), allow_nan=False)


def test_memory_stays_bounded() -> None:
    """Every CAN-ID, and then those of eight modules for hours."""
    model = BusModel(known_layouts(Config(), [NODE]), 500_000)
    for k in range(2 * 0x800):
        model.receive(Frame(k % 0x800, bytes(8)), k * 1e-3)
    ids = (0x080, 0x190, 0x0A0, 0x720, *range(0x1A0, 0x1A8))

    def burst(first: int) -> int:
        for k in range(first, first + 8_000):
            data = struct.pack("<IHH", k * 7919 % 2**32, 0xFF if k % 900 else 1, k % 30000)
            model.receive(Frame(ids[k % len(ids)], data), 10.0 + k * 0.1)
        return _size(model, set())

    warm = burst(0)
    assert burst(8_000) < 1.05 * warm


def _size(thing: object, seen: set[int]) -> int:
    if id(thing) in seen or isinstance(thing, type) or callable(thing):
        return 0
    seen.add(id(thing))
    inner: list[object] = list(vars(thing).values()) if hasattr(thing, "__dict__") else []
    if isinstance(thing, dict):
        inner += [*thing.keys(), *thing.values()]
    elif hasattr(thing, "__iter__") and not isinstance(thing, (str, bytes)):
        inner += list(thing)
    return sys.getsizeof(thing) + sum(_size(one, seen) for one in inner)


def shown(module: FeedbackModule, *noises: int) -> ModuleSnapshot:
    """With a SYNC of 1 kHz on the bus; ``noises`` are read by SDO, 1/65536 cycle."""
    model = BusModel(layouts := known_layouts(Config(modules=[module.config])))
    for k in range(50):
        model.receive(Frame(0x80, b""), k * 1e-3)
        model.receive(Frame(0x180 + NODE, struct.pack("<IHH", 0, 1, 0)), k * 1e-3 + 5e-4)
    for noise in noises:
        model.learn(*layouts).put(od.FEEDBACK_NOISE, noise, 0.05)
    ((_, found),) = model.snapshot().modules
    return found


def started(**fields: Any) -> FeedbackModule:
    module = FeedbackModule(ModuleConfig(node_id=NODE, **fields))
    module.dictionary.entry(*od.CYCLE_PERIOD).value = 1000
    module.start(0.0)
    return module


@given(
    per_sync=st.integers(1, 4),
    acceleration=st.sampled_from([0.0, 40.0, 3000.0]),
    limit=st.sampled_from([0.05, 1.0 / 3.0]),
    times=st.booleans(),
)
def test_by_the_configuration_and_the_sync_on_the_bus(
    per_sync: int, acceleration: float, limit: float, times: bool
) -> None:
    module = started(
        samples_per_sync=per_sync, max_acceleration_rad_s2=acceleration, residual_limit=limit, times=times
    )
    assert shown(module).residual_limit_cycles == pytest.approx(module.limits.residual_limit, abs=1e-6)


@each("noises, limit", [
    ((), 0.066), ((0,), 0.066), ((16,), 0.0159 + 6 * 16 / 65536), ((6000,), 0.066), ((100, 0), 0.066),
    # That of the noisiest of the last blocks.
    ((100, 16), 0.0159 + 6 * 100 / 65536), ((100, *range(16, 48)), 0.0159 + 6 * 47 / 65536),
])  # fmt: skip
def test_the_noise_that_was_read(noises: tuple[int, ...], limit: float) -> None:
    module = started(max_acceleration_rad_s2=40.0, noise_margin=6)
    found = shown(module, *noises)
    assert found.residual_limit_cycles == pytest.approx(limit, abs=5e-4)
    noise, known = noises[-1] if noises else 0, found.residual_noise_cycles
    assert known == (noise / 65536 if noise else None)
    assert residual_words(found).endswith(f", noise {noise / 65536:.4f}" if noise else "cycle")


def test_sample_times_widen_it_at_speed() -> None:
    module = started(max_acceleration_rad_s2=40.0, times=True)
    supervision = known_layouts(Config(modules=[module.config]))[0].supervision
    slow, fast = (supervision.limit_cycles(1000.0, None, velocity) for velocity in (0.0, 314.159))
    assert fast - slow == pytest.approx(4 * 125_000 * 50e-9, rel=1e-4)
    assert supervision.limit_cycles(1000.0, None, 1e9) == supervision.widest_cycles


def test_pairs_are_counted_to_the_first_that_is_not_mapped() -> None:
    pairs = [[one.mapped(16) for one in pair] for pair in od.SAMPLE_EARLIER]
    for there in itertools.product([False, True], repeat=7):
        mapped = [pair for pair, is_there in zip(pairs, there, strict=True) if is_there]
        first_gap = there.index(False) if False in there else 7
        assert samples_per_sync(mapped) == 1 + first_gap
    split = [[pairs[0][0]], [pairs[0][1]]]
    assert samples_per_sync(split) == 1, "both tracks in one RPDO"


def test_the_load_is_that_of_the_frames_that_were_there() -> None:
    network = MonitoredNetwork().run(2.05)
    load = network.model.snapshot(network.bus.now).load
    of_it = [frame for frame, now in network.frames if 1.0 <= now < 2.0]
    assert load.frames_per_s == pytest.approx(len(of_it), abs=1)
    assert load.bits_per_s == pytest.approx(sum(frame_bits(len(frame.data)) for frame in of_it), abs=140)
    assert load.load == pytest.approx(load.bits_per_s / BIT_RATE)


def test_a_full_bus_is_a_load_of_one() -> None:
    model = BusModel(bit_rate=125_000)
    now = 0.0
    while now < 3.0:
        model.receive(Frame(0x123, bytes(8)), now)
        now += frame_bits(8) / 125_000
    assert model.snapshot(now).load.load == pytest.approx(1.0, abs=0.01)
    assert model.snapshot(now + 2.0).load.load == 0.0
    assert BusModel().snapshot().load.load is None, "no bit rate"


@pytest.mark.parametrize("jitter_us", [0.0, 5.0, 50.0])
@pytest.mark.parametrize("period_s", [1e-3, 2.5e-3, 10e-3])
def test_jitter_that_is_known_is_measured(jitter_us: float, period_s: float) -> None:
    draw, meter = random.Random(7), SyncMeter()
    errors = []
    for k in range(600):
        errors.append(draw.uniform(-jitter_us, jitter_us) * 1e-6)
        if k % 97 != 5:  # not all are heard
            meter.sync(k * period_s + errors[-1])
    seen = meter.snapshot(600 * period_s)
    assert seen.rate_hz == pytest.approx(1.0 / period_s, rel=1e-4)
    assert seen.jitter_rms_s == pytest.approx(jitter_us * 1e-6 / math.sqrt(3.0), rel=0.08, abs=1e-9)
    assert seen.jitter_peak_s == pytest.approx(jitter_us * 1e-6, rel=0.06, abs=1e-9)


@pytest.mark.parametrize("period_s", [0.15, 0.5, 1.0])
def test_a_slow_sync_and_one_that_changes_its_rate_have_one(period_s: float) -> None:
    meter, now = SyncMeter(), 0.0
    for rate in (1.0, 0.4, 2.0):
        for _ in range(20):
            now += period_s * rate
            meter.sync(now)
        seen = meter.snapshot(now)
        assert seen.rate_hz == pytest.approx(1.0 / (period_s * rate), rel=1e-4)
        assert seen.jitter_peak_s == pytest.approx(0.0, abs=1e-9)


def test_duplicates_and_silence() -> None:
    meter = SyncMeter()
    assert meter.snapshot(1.0).silent_s is None
    for k in range(100):
        meter.sync(k * 1e-3)
        if k % 10 == 0:
            meter.sync(k * 1e-3 + 1e-5)
    assert meter.snapshot(0.1).rate_hz == pytest.approx(1000.0, rel=1e-3)
    silent = meter.snapshot(5.0)
    assert silent.rate_hz is None
    assert silent.silent_s == pytest.approx(4.901)
    assert sync_words(silent) == "no rate, the last 4.9 s ago", "also where too few came: that is not none"


@given(st.lists(st.floats(-1e6, 1e6), max_size=50), st.floats(-1e6, 1e6))
def test_whatever_times_syncs_have(times: list[float], now: float) -> None:
    meter = SyncMeter()
    for time_s in times:
        meter.sync(time_s)
    seen = meter.snapshot(now)
    assert seen.rate_hz is None or seen.rate_hz > 0.0


@given(st.lists(st.tuples(st.floats(0.0, 3.0), st.floats(0.0, 0.5)), min_size=1, max_size=100))
def test_the_history_has_the_peak_of_each_interval(steps: list[tuple[float, float]]) -> None:
    history, now, truth = Bins(0.5, 20, max), 0.0, dict[int, float]()
    for step, value in steps:
        now += step
        history.add(value, now)
        number = math.floor(now / 0.5)
        truth[number] = max(truth.get(number, 0.0), value)
    values = history.values(now)
    last = math.floor(now / 0.5)
    assert len(values) <= 20
    assert values == [truth.get(number) for number in range(last - len(values) + 1, last + 1)]
    assert values[-1] is not None
