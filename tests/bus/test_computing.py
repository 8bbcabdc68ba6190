"""Long computations: in another process, never waited for, never left behind."""

import contextlib
import os
import time
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from computing_jobs import add, crash, fail, never_end, tell_of_the_process

from canfb import FeedbackModule, Frame, ModuleConfig
from canfb.bus.computing import Computation
from canfb.bus.runner import Runner
from canfb.device.node import Computing
from canfb.module.objects.calibrating import CalibrationJob, Outcome
from canfb.signal.sample_recording import SampleRecording
from canfb.simulation.encoder import Encoder
from fake_bus import FakeBus, FakeClock, FakeDevice, frame_bus


class FakeComputer:
    """A device that has one thing to compute after the other, polled until something has happened."""

    def __init__(self, *jobs: Any, **options: Any) -> None:
        self.jobs = list(jobs)
        self.results: list[Any] = []
        self.parts: list[float] = []
        self.lines: list[str] = []
        self.frames: list[Frame] = []
        self.computation = Computation(self, self.lines.append, **options)

    def pending_job(self) -> Any:
        return self.jobs[0] if self.jobs else None

    def finish_job(self, job: Any, result: Any, now: float) -> list[Frame]:
        assert job is self.jobs.pop(0)
        self.results.append(result)
        return [Frame(0x123, bytes([len(self.results)]))]

    def job_progress(self, job: Any, part: float) -> None:
        assert job is self.jobs[0]
        self.parts.append(part)

    def poll_until(self, done: Callable[[], bool]) -> None:
        give_up = time.monotonic() + 60.0
        while not done():
            assert time.monotonic() < give_up
            self.frames += self.computation.poll(7.0)
            time.sleep(1e-3)  # the other process is a real one


@pytest.fixture
def computer() -> Iterator[Callable[..., FakeComputer]]:
    with contextlib.ExitStack() as stack:

        def make(*jobs: Any, **options: Any) -> FakeComputer:
            made = FakeComputer(*jobs, **options)
            stack.callback(made.computation.close)
            return made

        yield make


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


LONG = tuple(range(300_000))  # more than a pipe holds


def test_jobs_are_done_one_after_the_other_and_what_fails_is_told(computer: Any) -> None:
    jobs = [fail, partial(add, (1, 2)), crash, lambda tell: None, partial(add, LONG)]
    one = computer(*jobs)
    one.poll_until(lambda: not one.jobs)
    assert [None if isinstance(got, Exception) else got for got in one.results] == [
        *(None, 3, None, None, sum(LONG))
    ]
    assert one.parts == [0.25, 1.0] * 2
    assert one.frames == [Frame(0x123, bytes([n])) for n in range(1, len(jobs) + 1)]
    said = "the computation of a reference measurement failed: "
    assert one.lines[:2] == [
        f"{said}LookupError: nothing to be found",
        f"{said}the process ended without a result",
    ]
    assert len(one.lines) == 3, "and the one that cannot be sent"
    assert one.lines[2].startswith(said)


def test_it_is_another_process_that_gives_way_on_the_processors_that_ours_had(
    computer: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    one, before = computer(tell_of_the_process), os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})
    try:
        one.poll_until(lambda: bool(one.results))
    finally:
        os.sched_setaffinity(0, before)
    ((pid, niceness, program, processors, threads),) = one.results
    assert pid != os.getpid()
    assert niceness == min(os.getpriority(os.PRIO_PROCESS, 0) + 10, 19)
    assert program.endswith("compute_process.py"), "nothing of the program that uses it is run again"
    assert processors == before, "also those that ours has left"
    assert threads == "1", "frames must not wait for more of them"


@pytest.mark.parametrize("command", [("/nowhere/at-all",), ("/bin/echo", "no message at all")])
def test_a_process_that_is_none_of_ours_is_a_failure(computer: Any, command: tuple[str, ...]) -> None:
    one = computer(partial(add, LONG), command=command)
    one.poll_until(lambda: bool(one.results))
    assert isinstance(one.results[0], Exception)
    assert len(one.lines) == 1


def test_what_is_not_wanted_any_more_is_killed(computer: Any) -> None:
    one = computer(never_end)
    one.poll_until(lambda: bool(one.parts))
    pid = int(one.parts[0])
    assert is_alive(pid)
    one.jobs = [partial(add, (1,))]
    one.poll_until(lambda: bool(one.results))
    one.poll_until(lambda: not is_alive(pid))
    assert one.results == [1]


def test_the_job_of_the_module_gives_the_same_there_as_here(computer: Any) -> None:
    recording = SampleRecording()
    position = 0.31 * np.arange(2000) + 2.0 * np.sin(np.arange(2000) / 170.0)
    for sine, cosine in zip(*Encoder(noise_lsb=0.5).sample(position, np.random.default_rng(1)), strict=True):
        recording.take(int(sine), int(cosine))
    job = CalibrationJob(recording.to_bytes(), None, 12)
    device = computer(job)
    device.poll_until(lambda: bool(device.results))
    there, here = device.results[0], job()
    assert isinstance(there, Outcome)
    assert there.text == here.text
    assert there.calibration.table == here.calibration.table  # type: ignore[union-attr]
    assert device.parts == sorted(device.parts)
    assert device.parts[-1] == 1.0


def test_the_runner_computes_for_the_module_and_ends_it() -> None:
    """A second of real time at most: what it starts, it ends."""
    module = FeedbackModule(ModuleConfig(node_id=32))
    assert isinstance(module, Computing)
    clock = FakeClock()
    started: list[int] = []

    def finished() -> bool:
        module.dictionary.entry(0x2030, 1).store(1 if not started else 5) if len(started) < 2 else None
        started.append(1)
        time.sleep(1e-3)
        return module.dictionary.entry(0x2030, 2).current() == 4

    bus: Any = FakeBus(clock)
    Runner(frame_bus(bus), [module], clock=clock).run(finished)
    assert module.dictionary.entry(0x2030, 7).current() == 1, "too few samples"


class Idle(FakeDevice, FakeComputer):
    def __init__(self, clock: FakeClock, *jobs: Any) -> None:
        FakeDevice.__init__(self, clock)
        FakeComputer.__init__(self, *jobs)


def test_the_runner_kills_it_at_its_own_end() -> None:
    clock = FakeClock()
    device = Idle(clock, never_end)
    bus: Any = FakeBus(clock)

    def finished() -> bool:
        time.sleep(1e-3)
        return bool(device.parts)

    Runner(frame_bus(bus), [device], clock=clock).run(finished)
    assert not is_alive(int(device.parts[0]))
