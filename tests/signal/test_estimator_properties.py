"""What holds of the position while the machine and the faults keep what is declared.

Through the public interface of the chain only: episodes of tools/faults/samples with fixed seeds, and every
motion of a small grid.
"""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from test_bounded_motion import ends_through

from canfb import Sample, SignalChain
from canfb.signal.estimator import Estimator
from canfb.signal.limits import Declared as EstimatorDeclared, kept_samples
from canfb.signal.supervision import LOST, VALID
from folding import each
from ideal_tracks import counts_at
from tools.faults.machine import AMPLITUDE_COUNTS, positions
from tools.faults.samples.episodes import KINDS, Declared, Episode, Kind, State, draw, play
from tools.faults.samples.judge import judge

EPISODES = 10
MACHINES = {
    "0.01": Declared(0.01),
    "0.05": Declared(0.05),
    "0.1": Declared(0.1),
    "0.2": Declared(0.2),
    "sharp": Declared(0.05, 0.002),
    "two samples": Declared(0.05, samples_per_sync=2),
    "four samples": Declared(0.02, samples_per_sync=4),
}


def episodes(kind: Kind, machine: Declared, count: int = EPISODES, seed: int = 5) -> list[Episode]:
    return draw(kind, machine, count, np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("kind", "machine"),
    [
        pytest.param(kind, machine, id=f"{kind_name}-{name}")
        for kind_name, kind in KINDS.items()
        for name, machine in MACHINES.items()
        if kind.is_covered(machine) and not (machine.samples_per_sync > 1 and (kind.jitter or kind.stall))
    ],
)
def test_valid_is_right_and_stays_while_samples_are_good(kind: Kind, machine: Declared) -> None:
    """One more good sample takes the valid bit only by contradiction, and the truth contradicts nothing."""
    per_sync = machine.samples_per_sync
    for episode in episodes(kind, machine):
        published = play(episode)
        verdict = judge(episode, published)
        assert not verdict.early
        assert not verdict.silent
        valid = published.valid[per_sync - 1 :: per_sync]
        bad = (episode.state != State.GOOD)[per_sync - 1 :: per_sync]
        after = int(np.flatnonzero(bad)[-1]) + 1 if bad.any() else episode.fault // per_sync
        assert kind.bad or (np.diff(valid[after:].astype(int)) >= 0).all()


@pytest.mark.parametrize("kind", ["jitter", "stall"])
@pytest.mark.parametrize("name", ["0.01", "0.1", "sharp"])
def test_uneven_instants_cost_nothing_where_one_motion_fits(kind: str, name: str) -> None:
    """A stall of three intervals at 0.01 leaves one motion; jitter always does."""
    one = KINDS[kind]
    machine = MACHINES[name]
    if one.stall is not None:
        machine, one = MACHINES["0.01"], replace(one, stall=(1.5, 3.0))
    for episode in episodes(one, machine):
        verdict = judge(episode, play(episode))
        assert verdict.kept
        assert not verdict.silent


def changes() -> dict:
    """What may be changed in a doubt: the machine keeps both what was declared before and what is after."""
    before = Declared(0.1)
    return {
        "wider limits": (before, Declared(0.2)),
        "a larger phase error": (before, Declared(0.1, 0.02)),
        "no bad sample": (before, Declared(0.1, bad_samples=1)),
    }


@pytest.mark.parametrize("change", changes())
@pytest.mark.parametrize(
    "kind", ["missing 1", "missing 3", "gaps close together", "flagged 1", "flagged 2, 3"]
)
@pytest.mark.parametrize("later", [0, 1, 3])
def test_a_change_of_limits_in_doubt_never_gives_a_wrong_position(kind: str, change: str, later: int) -> None:
    before, after = changes()[change]
    for episode in episodes(KINDS[kind], Declared(0.1), 8):
        limits, at = after.limits, episode.fault + later
        chain = before.chain()
        chain.restart(0, float(episode.truth[1] - episode.truth[0]))

        def change_limits(chain: SignalChain, k: int, limits=limits, at=at) -> None:
            if k == at:
                chain.set_limits(limits)

        published = play(episode, chain, change_limits)
        assert not judge(episode, published).wrong


@pytest.mark.parametrize("per_sync", [(1, 2), (2, 1), (1, 4)])
@pytest.mark.parametrize("later", [None, 0, 1, 2])
def test_a_change_of_the_samples_per_sync_in_a_doubt_never_gives_a_wrong_position(
    per_sync: tuple[int, int], later: int | None
) -> None:
    """One missing sample (None: none is), and from a SYNC after it on there are more or fewer in each."""
    rng = np.random.default_rng(7)
    whole = Declared(0.02)
    change = 20 + (later or 0)
    many = [per_sync[0] if k < change else per_sync[1] for k in range(50)]
    inside = np.concatenate([k + 1.0 - np.arange(m - 1, -1.0, -1.0) / m for k, m in enumerate(many)])
    for _ in range(15):
        u, speed = rng.uniform(-0.02, 0.02, (1, 60)), rng.uniform(-20.0, 20.0, 1)
        truth = positions(u, speed, rng, inside[None, :])[0].tolist()
        chain = _faster(whole, per_sync[0]).chain()
        chain.restart(0, float(speed[0]) / per_sync[0])
        offset, taken = None, 0
        for k, count in enumerate(many):
            if k == change:
                chain.set_limits(_faster(whole, count).limits)
            here = truth[taken : taken + count]
            taken += count
            if k == 19 and later is not None:
                chain.miss()
                continue
            newest, *earlier = (counts_at(one, AMPLITUDE_COUNTS) for one in reversed(here))
            feedback = chain.step(Sample(*newest, earlier=tuple(earlier)))
            error = here[-1] - feedback.cycles - feedback.phase
            offset = round(error) if offset is None else offset
            assert not feedback.valid or abs(error - offset) < 0.5, k
            assert feedback.valid or later is not None


def _faster(machine: Declared, per_sync: int) -> Declared:
    """The same machine, with so many samples in each interval."""
    return replace(machine, acceleration=machine.acceleration / per_sync**2, samples_per_sync=per_sync)


@pytest.mark.parametrize("missed", [0, 1, 2])
@pytest.mark.parametrize("later", [0, 1, 2])
def test_a_change_of_the_period_in_a_doubt_never_gives_a_wrong_position(missed: int, later: int) -> None:
    """From one SYNC on the interval is twice as long: 0.02 cycle per interval^2 become 0.08."""
    rng = np.random.default_rng(11)
    for _ in range(15):
        slow, fast = Declared(0.02), Declared(0.08)
        u, speed = rng.uniform(-0.02, 0.02, (1, 120)), rng.uniform(-20.0, 20.0, 1)
        change = 20 + missed + later
        instants = np.concatenate((np.arange(change), change - 1.0 + 2.0 * np.arange(1, 30)))
        truth = positions(u, speed, np.random.default_rng(2), instants[None, :])[0]
        chain = slow.chain()
        chain.sync_interval_s = 1e-3
        chain.restart(0, float(speed[0]))
        offset = None
        for k, position in enumerate(truth.tolist()):
            if k == change:
                chain.set_limits(fast.limits)
                chain.sync_interval_s = 2e-3
            if 20 <= k < 20 + missed:
                chain.miss()
                continue
            ticks = round(float(instants[k]) * 1e4)
            feedback = chain.step(Sample(*counts_at(position, AMPLITUDE_COUNTS), time_100ns=ticks))
            error = position - feedback.cycles - feedback.phase
            offset = round(error) if offset is None else offset
            assert not feedback.valid or abs(error - offset) < 0.5


GRID = 60  # steps of a cycle: 0.1 cycle per interval^2 are 6 of them
GOOD_AFTER = 6


@pytest.mark.parametrize("speed", [0, 30, 20, 7 * GRID + 25])
@each("missed, bound", [(1, 3), (1, 6), (1, 10), (1, 12), (2, 3), (2, 6), (2, 8), (3, 3), (3, 6)])
def test_every_motion_of_a_small_grid_over_missing_samples(missed: int, speed: int, bound: int) -> None:
    """All 3^n motions with -B, 0, +B around a gap: valid only where one end is left, and there at once.

    Enumeration lists the motions on the grid; where it has two the position must not be valid. Where it has
    one by a margin of the phase error, which the estimator has to allow, the position must be valid.
    """
    machine = Declared(bound / GRID, 0.002)
    # What the phase error adds to a difference and the program's slack: fewer motions with a bound above it.
    wider = bound + 2 + missed
    for differences in product((-bound, 0, bound), repeat=3):
        motion = [speed * k for k in range(12)]
        for one in (*differences, *[0] * (GOOD_AFTER + missed + 2 - len(differences))):
            motion.append(2 * motion[-1] - motion[-2] + one)
        chain = machine.chain()
        chain.restart(0, speed / GRID)
        for position in motion[:12]:
            assert chain.step(Sample(*counts_at(position / GRID, AMPLITUDE_COUNTS))).valid
        phases: list[int | None] = [None] * missed
        for _ in range(missed):
            chain.miss()
        for position in motion[12 + missed : 12 + missed + 3]:
            feedback = chain.step(Sample(*counts_at(position / GRID, AMPLITUDE_COUNTS)))
            phases.append(position % GRID)
            narrow = ends_through(motion[10:12], phases, GRID, bound)
            assert position in narrow
            if feedback.valid:
                assert len(narrow) == 1  # else it was guessed
                assert feedback.cycles == round(position / GRID - feedback.phase)
            elif len(phases) <= 3 + missed:
                wide = ends_through(motion[10:12], phases, GRID, wider)
                assert len(wide) > 1


@pytest.mark.parametrize("flagged", [False, True])
@each("bound, phase_error", [(0.01, 0.0125), (0.05, 0.0125), (0.1, 0.0125), (0.1, 0.002), (0.16, 0.001)])
def test_as_many_samples_in_a_row_are_bridged_as_is_said(
    bound: float, phase_error: float, flagged: bool
) -> None:
    """The largest motions and errors, in every pattern of their signs at random."""
    declared = EstimatorDeclared(
        residual_limit=bound + 4.0 * phase_error,
        acceleration=bound,
        phase_error=phase_error,
        coast_samples=40,
    )
    kept = declared.kept_samples()
    assert kept == kept_samples(bound, bound, phase_error)
    assert 1 <= kept < 40
    generator = np.random.default_rng(11)
    for _ in range(40):
        x = generator.choice([-0.999, 0.999], 80 + kept) * bound
        x = np.repeat(x[::7], 7)[: len(x)] if generator.random() < 0.5 else x
        x[:6] = 0.0  # from standstill
        x = np.cumsum(np.cumsum(x))
        x += 0.5
        shown = x + generator.choice([-0.999, 0.999], len(x)) * phase_error
        estimator = Estimator(declared)
        for position in shown[:40]:
            assert estimator.good(position % 1.0, 1.0)[1] == VALID
        for _ in range(kept):
            estimator.bad(1.0, missed=not flagged)
        bits = []
        for number in range(40 + kept, len(x)):
            track, status = estimator.good(shown[number] % 1.0, 1.0)
            bits.append(status)
            if status & VALID:
                assert abs(track.cycles + track.phase - x[number]) < 0.5 + 0.001
        assert bits[-1] == VALID
        assert not any(status & LOST for status in bits)
