"""Object 2030h: the module measures its own reference, and goes on publishing."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from canopen import SdoAbortedError
from measuring import (
    DEVICE_STATE,
    ENCODER,
    NUMBER,
    SAMPLES,
    Counts,
    Measuring,
    computed,
    counts_of,
    good_outcome,
    motion,
)

from canfb.calibration.deviation import drift
from canfb.calibration.result import Reason
from canfb.cia301.frame import Frame
from canfb.device.storage.storage import MemoryStore
from canfb.module.objects.calibrating import CalibrationJob
from canfb.objects import MeasurementCommand as Command
from canfb.objects import MeasurementState as State
from canfb.objects import StatusBit
from canfb.simulation.encoder import Encoder, Harmonic
from ideal_tracks import wavy_table

WAVY = wavy_table()


def any_counts(rng: np.random.Generator) -> Counts:
    sine, cosine = rng.integers(-2048, 2048, 2).tolist()
    return sine, cosine


def refused(bench: Measuring, command: int, code: int) -> None:
    with pytest.raises(SdoAbortedError) as error:
        bench.command(command)
    assert error.value.code == code


@pytest.mark.parametrize("cycles_per_sample", [0.013, 0.31, 2.71, 123.456], ids=str)
def test_the_whole_story_at_any_speed(cycles_per_sample: float) -> None:
    """Recorded, computed, accepted: all the while every SYNC has its position, and it is right."""
    rng = np.random.default_rng(7)
    position = motion(cycles_per_sample, SAMPLES + 600, rng)
    samples = counts_of(ENCODER, position, rng)
    bench, twin = Measuring(), Measuring()
    twin.start()
    bench.begin()
    assert (bench.state, bench.is_calibrating) == (State.RECORDING, True)
    seen = [bench.sdo[0x2030][3].raw]
    for first in range(0, SAMPLES, 500):
        part = samples[first : first + 500]
        published = bench.feed(part)
        assert len(published) == len(part)
        marked = [(units, status | StatusBit.CALIBRATING, off) for units, status, off in twin.feed(part)]
        assert published == marked
        seen.append(bench.sdo[0x2030][3].raw)
    assert seen == sorted(set(seen))
    assert (bench.state, bench.is_calibrating) == (State.COMPUTING, True)
    assert bench.sdo[0x2030][4].raw >= 95
    published = bench.feed(samples[SAMPLES : SAMPLES + 300])
    assert len(published) == 300, "while it computes, too"
    assert all(status & StatusBit.CALIBRATING for _, status, _ in published)
    result = bench.compute()
    assert result.calibration is not None
    assert bench.in_force() == (0, 0, 0), "nothing is in force before it is accepted"
    bench.command(Command.ACCEPT)
    assert bench.sdo.upload(0x2020, 1) == result.calibration.table.to_bytes()
    assert bench.figures()[2:] == [0.0, 0.0]
    after = np.array([units for units, _, _ in bench.feed(samples[SAMPLES + 300 :])]) / 8192
    off = (after - position[SAMPLES + 300 :] + 0.5) % 1.0 - 0.5
    before = np.array([units for units, _, _ in twin.feed(samples[SAMPLES + 300 :])]) / 8192
    raw_off = (before - position[SAMPLES + 300 :] + 0.5) % 1.0 - 0.5
    assert np.std(off) < 3e-4
    assert np.std(raw_off) > 5e-3


@pytest.mark.parametrize("seed", range(4))
def test_random_encoders_motions_and_faults(seed: int) -> None:
    """Lost samples, glitches and a burst cost accuracy, no more."""
    rng = np.random.default_rng(seed)
    encoder = replace(
        ENCODER,
        sine_offset=rng.uniform(-0.1, 0.1),
        cosine_amplitude=rng.uniform(0.9, 1.1),
        phase_error_rad=rng.uniform(-0.1, 0.1),
        harmonics=(Harmonic(3, *rng.uniform(0.0, 0.02, 2), *rng.uniform(0.0, 6.0, 2)),),
    )
    samples: list[Counts | None] = [
        *counts_of(encoder, motion(10.0 ** rng.uniform(-1.5, 2.0), SAMPLES, rng), rng)
    ]
    for place in rng.integers(0, SAMPLES, 60).tolist():
        samples[place] = None if rng.random() < 0.5 else any_counts(rng)
    start = int(rng.integers(0, SAMPLES - 20))
    samples[start : start + 20] = [None] * 20
    bench = Measuring()
    bench.begin()
    bench.feed([(0, 1500)] * 2)
    bench.command(Command.START)
    bench.feed(samples)
    result = bench.compute()
    assert bench.state == State.READY, result.text
    truth = computed(encoder, seed).calibration
    assert truth is not None
    bench.command(Command.ACCEPT)
    found = drift(truth, bench.module.chain.correction.table, bench.module.chain.correction.conditioning)
    assert found.rms < 2e-4


def test_a_poor_encoder_whose_position_is_lost_is_measured_all_the_same() -> None:
    """40 % offset, 20 % amplitude error, started at speed: the count is wrong, the samples are not."""
    rng = np.random.default_rng(3)
    poor = Encoder(
        amplitude_counts=1250.0,
        sine_offset=0.4,
        cosine_offset=-0.4,
        sine_amplitude=1.2,
        cosine_amplitude=0.8,
        noise_lsb=0.5,
    )
    time = np.arange(SAMPLES)
    bench = Measuring()
    bench.begin()
    published = bench.feed(counts_of(poor, 0.37 * time + 3.0 * np.sin(time / 150.0), rng))
    assert any(status & StatusBit.LOST for _, status, _ in published)
    result = bench.compute()
    assert bench.state == State.READY, result.text
    bench.command(Command.ACCEPT)
    bench.remote.nmt.state = "PRE-OPERATIONAL"
    bench.module.chain.restart()  # it was lost in motion, and a start alone does not say that it stands now
    bench.start()
    published = bench.feed(counts_of(poor, motion(5.3, 600, rng), rng))
    assert {status for _, status, _ in published} == {StatusBit.VALID | StatusBit.TABLE_ACTIVE}


# --- refusals -------------------------------------------------------------------------------------------


def recordings(rng: np.random.Generator, n: int) -> dict[str, Sequence[Counts | None]]:
    time = np.arange(float(n))
    moving = motion(0.31, n, rng)
    good = counts_of(ENCODER, moving, rng)
    large = counts_of(replace(ENCODER, amplitude_counts=2300.0), moving, rng)
    return {
        "samples": [*good[:150], *[None] * (n - 149)],  # a SYNC tells that the sample before it is missing
        "clipped": large,
        "ellipse": [(sine, 1500) for sine, _ in good],
        "coverage": counts_of(ENCODER, np.full_like(time, 0.3), rng),
        "cycles": counts_of(ENCODER, time * 5.0 / n, rng),
        "locked": counts_of(ENCODER, 0.125 * time, rng),
        "noise": counts_of(replace(ENCODER, noise_lsb=200.0), moving, rng),
    }


@pytest.mark.parametrize("reason", recordings(np.random.default_rng(1), 300))
def test_what_cannot_be_used_is_refused_with_its_reason(reason: str) -> None:
    bench = Measuring()
    bench.activate(WAVY)
    bench.begin()
    bench.feed(recordings(np.random.default_rng(1), SAMPLES)[reason])
    result = bench.compute()
    assert (bench.state, bench.reason, bench.sdo[0x2030][7].raw) == (
        State.REFUSED,
        reason,
        NUMBER[Reason(reason)],
    ), result.text
    assert not bench.is_calibrating
    assert bench.sdo[0x2030][3].raw == 100
    assert all(math.isnan(figure) for figure in bench.figures()[2:]), "no drift from what is refused"
    refused(bench, Command.ACCEPT, DEVICE_STATE)
    assert bench.in_force()[1] == WAVY.crc32
    bench.command(Command.START)
    assert (bench.state, bench.reason) == (State.RECORDING, "accepted")


# --- commands and states ---------------------------------------------------------------------------------


def test_the_number_of_samples_counts_from_the_next_start() -> None:
    bench = Measuring(200)
    bench.remote.nmt.state = "RESET"
    assert bench.sdo[0x2030][10].raw == 20000
    bench.sdo[0x2030][10].raw = 200
    bench.begin()
    bench.sdo[0x2030][10].raw = 300
    bench.feed([(0, 1500)] * 199)
    assert (bench.state, bench.sdo[0x2030][3].raw) == (State.RECORDING, 79)
    bench.feed([(0, 1500)])
    assert bench.state == State.COMPUTING
    bench.command(Command.START)
    bench.feed([(0, 1500)] * 250)
    assert bench.state == State.RECORDING


def test_the_progress_covers_the_computation() -> None:
    bench = Measuring()
    bench.begin()
    bench.command(Command.FINISH)
    job = bench.module.pending_job()
    assert job is not None
    seen = []
    for part in (0.0, 0.5, 1.0, 7.0, -1.0):
        bench.module.job_progress(job, part)
        seen.append(bench.sdo[0x2030][3].raw)
    assert seen == [80, 89, 99, 99, 80]
    bench.command(Command.START)
    bench.module.job_progress(job, 1.0)
    assert bench.sdo[0x2030][3].raw == 0


# --- beside it --------------------------------------------------------------------------------------------


def test_what_was_accepted_can_be_saved_and_is_in_force_after_a_reset() -> None:
    store = MemoryStore()
    bench = Measuring(store=store)
    result = bench.ready().calibration
    assert result is not None
    bench.sdo[0x1020][1].raw = 7
    bench.command(Command.ACCEPT)
    assert bench.sdo[0x1020][1].raw == 0, "the configuration is another one now"
    bench.sdo.download(0x1010, 1, b"save")
    bench.remote.nmt.state = "RESET"
    assert bench.in_force() == (0, result.table.crc32, len(result.table))
    assert bench.module.chain.correction.conditioning == result.conditioning
    assert bench.state == State.IDLE


# --- samples ------------------------------------------------------------------------------------------------


def recorded(bench: Measuring) -> tuple[CalibrationJob, list[tuple[int, int]]]:
    bench.command(Command.FINISH)
    job = bench.module.pending_job()
    assert job is not None
    return job, list(struct.iter_unpack("<hh", job.samples))


MISSED = (-32768, -32768)


def test_flagged_samples_are_left_out_and_keep_their_place() -> None:
    bench = Measuring()
    bench.start()
    bench.feed([(0, 1500)] * 5)
    bench.command(Command.START)
    bench.feed([(0, 1500), (0, 100), None, (9, 1500), (2047, 0), (9, 1500)])
    bench.map_rpdo2(0x20000608)
    for flags in (0, 2, 1):
        bench.sync()
        bench.sent(Frame(0x290, bytes([flags])))
        bench.counts(7, 1500)
    _, pairs = recorded(bench)
    assert pairs[:6] == [(0, 1500), MISSED, MISSED, (9, 1500), (2047, 0), (9, 1500)], (
        "a small amplitude is a fault; what is clipped stays, for the computation to tell"
    )
    assert pairs[6:] == [(7, 1500), MISSED, (7, 1500)], "2000:06: invalid"


@pytest.mark.parametrize("full_scale", [2048, 2000, 32768, 65535])
def test_clipped_samples_are_found_as_such_whatever_the_full_scale(full_scale: int) -> None:
    bench = Measuring(amplitude_high_counts=65535)
    bench.sdo[0x2001][2].raw = full_scale
    bench.begin()
    top = min(full_scale - 1, 32767)
    bench.feed([(top, 10), (-top - 1, 10), (3, 10)])
    job, pairs = recorded(bench)
    full = 1 << (job.adc_bits - 1)
    assert [pair[0] for pair in pairs][:2] == [full - 1, -full] if full_scale < 65535 else True
    assert full >= min(full_scale, 32768)


def test_sample_times_count_where_they_come() -> None:
    """At uneven times a constant speed looks like noise; with the times it is a straight line."""
    rng = np.random.default_rng(9)
    bench = Measuring(2000)
    bench.map_rpdo2(0x20000520)
    bench.begin()
    time_s = 429.4 + (np.arange(2100) + rng.uniform(-0.3, 0.3, 2100)) * 1e-3  # the 32 bits wrap at 429.5 s
    for tick, counts in zip(
        (time_s * 1e7).astype(np.int64).tolist(), counts_of(ENCODER, 83.2e3 * time_s, rng), strict=True
    ):
        if rng.random() < 0.02:
            bench.sync()
            continue
        bench.sync()
        bench.sent(Frame(0x290, struct.pack("<I", tick % (1 << 32))))
        bench.counts(*counts)
        if bench.state == State.COMPUTING:
            break
    job = bench.module.pending_job()
    assert job is not None
    assert job.times is not None
    assert replace(job, times=None)().reason == "noise"
    result = bench.compute()
    assert bench.state == State.READY, result.text
    truth = good_outcome().calibration
    assert truth is not None
    assert result.calibration is not None
    assert drift(truth, result.calibration.table, result.calibration.conditioning).rms < 3e-4
