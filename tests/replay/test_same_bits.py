"""What a module sent live, the replay of the log sends again, byte for byte; margins of several samples."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from canfb import Frame, StatusBit
from canfb.device.storage.storage import MemoryStore
from canfb.logs.log_replay import ReplayOptions, replay_log
from canfb.replay.findings import Block
from canfb.replay.module_replay import Begin, ModuleReplay
from canfb.replay.replay_result import ReplayResult
from canfb.signal.conditioning import IDENTITY
from canfb.signal.correction import Correction
from commissioning_kit import TABLE
from drawing import examples
from ideal_tracks import adc_pdo, counts_at
from replay_kit import (
    ADC_ID,
    EPOCH_S,
    NODE_ID,
    PERIOD_S,
    POSITION_ID,
    SYNC_ID,
    Planned,
    config,
    contents,
    live,
    motion,
    nmt,
    replayed,
    sdo_write,
    session,
    write_log,
)


def assert_equal(replay: ModuleReplay) -> None:
    for one in replay.compared.values():
        assert one.different == one.only_recorded == one.only_replayed == 0


def same(plan: list[Planned], **fields: Any) -> ModuleReplay:
    log, sent = live(plan, **fields)
    replay, again = replayed(log, **fields)
    assert contents(again) == contents(sent)
    assert_equal(replay)
    assert replay.recorded_own == len(sent)
    return replay


@pytest.mark.parametrize(
    "fields", [{}, {"predict": 2}, {"autostart": True}, {"max_acceleration_rad_s2": 20.0}]
)
def test_a_motion(fields: dict[str, Any]) -> None:
    replay = same(session(jitter_s=2e-5 if fields else 0.0), **fields)
    assert replay.compared[POSITION_ID].equal == replay.samples.rows == 300
    assert fields or not any(replay.faults.times.values())


def test_heartbeat_event_timer_inhibit_time_and_speed() -> None:
    plan = [
        (0.01, sdo_write(0x1017, 0, struct.pack("<H", 7))),
        (0.011, sdo_write(0x1800, 1, struct.pack("<I", 0x800001A0))),
        (0.012, sdo_write(0x1800, 3, struct.pack("<H", 25))),
        (0.013, sdo_write(0x1800, 5, struct.pack("<H", 40))),
        (0.014, sdo_write(0x1800, 1, struct.pack("<I", 0x1A0))),
        *session(jitter_s=3e-5),  # no frame comes at the instant of a timer
    ]
    replay = same(plan)
    assert replay.compared[0x700 + NODE_ID].equal > 40


def test_faults_reset_and_saved_parameters() -> None:
    plan = session(600)
    del plan[100:102], plan[200], plan[300:330]
    plan[401] = (plan[401][0], adc_pdo(0.1, 3000.0))
    plan[451] = (plan[451][0], Frame(ADC_ID, b"\1"))
    plan += [(0.9, sdo_write(0x1010, 1, b"save")), (0.95, nmt(129)), (1.0, nmt(1)), *motion(100, 1.1)]
    log, sent = live(plan, MemoryStore())
    replay, again = replayed(log, MemoryStore())
    assert contents(again) == contents(sent)
    faults = replay.faults
    assert faults.samples["missed"] > 15
    assert faults.times["lost"] >= 1
    assert faults.times["amplitude"] == 1
    assert replay.emergencies > 0
    assert replay.restarts == 0


@pytest.mark.parametrize("at_s", [5.0, 0.5])
def test_a_module_that_is_switched_off_and_on(at_s: float) -> None:
    first, sent_first = live(session(200))
    second, sent_second = live(session(200, speed=0.03))
    again = [frame._replace(timestamp=(frame.timestamp or 0.0) + at_s) for frame in second]
    replay, sent = replayed([*first, *again])
    assert contents(sent[: len(sent_first)]) == contents(sent_first)
    assert contents(sent[-len(sent_second) :]) == contents(sent_second)
    between = sent[len(sent_first) : -len(sent_second)]
    assert {frame.can_id for frame in between} == {0xA0, POSITION_ID}, "it misses the SYNC until then"
    assert replay.restarts == 1


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".trc", ".log.gz", ".mf4", ".back.log"])
def test_through_a_file_of_each_format(tmp_path: Path, suffix: str) -> None:
    if suffix == ".mf4":
        pytest.importorskip("asammdf")
    log, sent = live(session(200, speed=0.9, jitter_s=1e-5))
    if ".back" in suffix:  # the clock was set before a SYNC
        begin = [frame.can_id for frame in log].index(SYNC_ID, len(log) - 400)
        log[begin:] = [one._replace(timestamp=(one.timestamp or 0.0) - 0.05) for one in log[begin:]]
    path = write_log(tmp_path / f"bus{suffix}", log)
    again: list[Frame] = []
    read, results = replay_log(path, ReplayOptions((config(),)), sent=again.append)
    assert contents(again) == contents(sent)
    assert read.trouble is None
    assert_equal(results[0].replay)


def test_a_log_that_starts_in_the_middle() -> None:
    log, _ = live(session(400, speed=0.25))
    middle = next(n for n, frame in enumerate(log) if frame.can_id == SYNC_ID and n > 600)
    replay, _ = replayed(log[middle:])
    assert replay.samples.rows == replay.compared[POSITION_ID].equal + replay.compared[POSITION_ID].different
    position = replay.compared[POSITION_ID].differences[0]
    assert position.name == "6004h:00"
    assert position.least == position.most, "cycles of before are not in the log"
    assert position.least < 0
    assert "begins in motion" in ReplayResult(replay, None, 0).notes()[0]
    assert ReplayResult(replayed(log)[0], None, 0).notes() == []
    assert replayed(log[middle:], options={"begin": Begin.PRE_OPERATIONAL})[0].samples.rows == 0


def test_other_limits_than_those_of_the_log_are_noted() -> None:
    read = [(0.3, Frame(0x620, struct.pack("<BHB4x", 0x40, 0x2001, 4)))]
    plan = session(300, speed=0.02)
    plan[400] = (plan[400][0], adc_pdo(0.1, 2000.0))
    for more, note in ((read, "other values in 2001h:04"), ([], "EMCY are not in the log")):
        log, _ = live(sorted([*plan, *more], key=lambda planned: planned[0]))
        assert note in ReplayResult(replayed(log, amplitude_high_counts=1400)[0], None, 0).notes()[0]
    moved = [sdo_write(0x1014, 0, struct.pack("<I", cob_id)) for cob_id in (0x800000A0, 0x3A0)]
    log, _ = live([*zip((1e-3, 2e-3), moved, strict=True), *plan], amplitude_high_counts=1400)
    assert ReplayResult(replayed(log, amplitude_high_counts=1400)[0], None, 0).notes() == []


@pytest.mark.parametrize("times", [False, True])
def test_sample_times_that_only_the_log_or_the_configuration_has_are_noted(times: bool) -> None:
    log, _ = live(session(300, speed=0.02))
    longer = [one._replace(data=one.data + bytes(4)) if one.can_id == ADC_ID else one for one in log]
    replay, _ = replayed(log if times else longer, times=times)
    assert f"--set times={str(not times).lower()}" in ReplayResult(replay, None, 0).notes()[0]


def test_another_table_is_tried() -> None:
    log, _ = live([*session(200), (0.5, nmt(129)), (0.51, nmt(1)), *motion(50, 0.6)])
    replay, sent = replayed(log, options={"correction": Correction(TABLE, IDENTITY)})
    words = [struct.unpack("<IHH", frame.data)[1] for frame in sent if frame.can_id == POSITION_ID]
    assert len(words) >= 250
    assert all(word & StatusBit.TABLE_ACTIVE for word in words), "after the reset, too"
    assert replay.compared[POSITION_ID].different > 100


def test_frames_that_one_side_lacks_and_odd_stamps_do_not_shift_the_pairs() -> None:
    log, _ = live(session(300))
    positions = [n for n, frame in enumerate(log) if frame.can_id == POSITION_ID]
    found = replayed([one for n, one in enumerate(log) if n not in positions[50:53]])[0].compared[POSITION_ID]
    assert (found.equal, found.different, found.only_replayed) == (297, 0, 3)
    extra = log[positions[99]]._replace(data=b"12345678")
    found = replayed([*log[: positions[99]], extra, *log[positions[99] :]])[0].compared[POSITION_ID]
    assert found.equal >= 299
    assert found.different + found.only_recorded >= 1
    for stamp, odd in ((None, (0, 0, 1)), (float("nan"), (0, 0, 1)), (9e9, (0, 1, 0)), (0.0, (1, 0, 0))):
        replay, _ = replayed([*log[:-1], log[-1]._replace(timestamp=stamp)])
        assert (replay.steps_back, replay.gaps, replay.bad_stamps) == odd


EVENTS = st.one_of(
    st.builds(lambda: Frame(SYNC_ID, b"")),
    st.builds(adc_pdo, st.floats(-3.0, 3.0), st.sampled_from([100.0, 1500.0, 2047.0])),
    st.builds(nmt, st.sampled_from([1, 2, 128, 129, 130]), st.sampled_from([0, NODE_ID, 5])),
    st.builds(
        sdo_write,
        st.sampled_from([0x1017, 0x1005, 0x1006, 0x1400, 0x1800, 0x2010, 0x2001, 0x2020, 0x6000, 0x2013]),
        st.integers(0, 6),
        st.binary(min_size=1, max_size=4),
    ),
    st.builds(Frame, st.integers(0, 0x7FF), st.binary(max_size=8), st.booleans()),
)
STEPS = st.floats(1e-5, 0.02).map(lambda step: round(step, 6) + 3.7e-7)
SPEED_ID = 0x280 + NODE_ID
OWN = {0x700 + NODE_ID, *(base + NODE_ID for base in (0x80, 0x180, 0x280, 0x380, 0x480, 0x580))}


@examples(60)
@given(st.lists(st.tuples(STEPS, EVENTS), max_size=60), st.integers(1, 7))
def test_any_sequence(events: list[tuple[float, Frame]], pieces: int) -> None:
    """Any frames, live and replayed, in one piece and in several."""
    at, plan, foreign = 0.2, session(20), False
    for step, frame in events:
        at += step
        plan.append((at, frame))
        # Live it is a duplicate; in a log nobody can tell it from the module.
        foreign = foreign or (frame.can_id in OWN and not frame.rtr)
    log, sent = live(plan)
    replay, again = replayed(log)
    # A COB-ID that was written may be that of another frame, too.
    moved = replay.module.own_can_ids - OWN
    if not foreign and not moved:  # the speed at half a period is that of one clock or of the other
        assert [(one.can_id, one.can_id != SPEED_ID and one.data) for one in again] == [
            (one.can_id, one.can_id != SPEED_ID and one.data) for one in sent
        ]
    whole: list[Frame] = []
    divided = ModuleReplay(config(), sent=whole.append)
    for n in range(pieces):
        divided.feed(log[n * len(log) // pieces : (n + 1) * len(log) // pieces])
    divided.close()
    assert whole == again


SPEED = 0.035  # cycles from sample to sample
GLITCH_AT, GLITCH = 200, 0.05
WEAK_AT, WEAK_COUNTS = 300, 900.0


def of_two() -> list[Planned]:
    plan: list[Planned] = []
    for n in range(500):
        at = 0.1 + n * PERIOD_S
        newest = counts_at(2 * n * SPEED + (GLITCH if n == GLITCH_AT else 0.0))
        earlier = counts_at((2 * n - 1) * SPEED, WEAK_COUNTS if n == WEAK_AT else 1500.0)
        plan += [
            (at, Frame(SYNC_ID, b"")),
            (at + 2e-4, Frame(ADC_ID, struct.pack("<hhhh", *newest, *earlier))),
        ]
    return plan


def test_margins_of_all_samples() -> None:
    """Behind a glitch the residual is twice as large, and here that is an earlier sample."""
    fields: dict[str, Any] = {"autostart": True, "samples_per_sync": 2}
    log, sent = live(of_two(), **fields)
    rows: list[Block] = []
    replay, again = replayed(log, options={"takers": [rows.append]}, **fields)
    assert contents(again) == contents(sent)
    assert replay.samples.rows == sum(len(block["time_s"]) for block in rows) == 500
    assert min(float(np.min(block["amplitude_counts"][5:])) for block in rows) > 1490.0
    of_rows = max(float(np.max(block["residual"][5:])) for block in rows)
    residual, amplitude_low = (replay.margins.nearest[name] for name in ("residual", "amplitude_low"))
    assert residual.value == pytest.approx(2 * GLITCH, abs=0.03)
    assert residual.value > of_rows + 0.02
    assert residual.time_s == pytest.approx(EPOCH_S + 0.1 + (GLITCH_AT + 1.2) * PERIOD_S, abs=1e-4)
    assert amplitude_low.value == pytest.approx(WEAK_COUNTS, abs=2.0)
