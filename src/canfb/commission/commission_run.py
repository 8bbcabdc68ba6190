"""``canfb commission`` from the first sample to the last file.

New limits are written, read back, watched and saved; or those from before are in force again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from canfb import objects as od
from canfb.calibrate.artefacts import keep_samples
from canfb.calibrate.calibration_run import Steps
from canfb.calibrate.choices import refuse_beyond
from canfb.calibrate.measurement import supervise
from canfb.commission.commission_summary import Commissioned, findings, write_page
from canfb.commission.limit_choice import LEAST_SAMPLES, Observation, choose, observe
from canfb.errors import CanfbError
from canfb.master.access import CommissioningError, Master, NodeAccess
from canfb.master.all_or_nothing import Guard, change, check_can_save, check_unlocked
from canfb.master.machine_watch import (
    Provenance,
    SpeedReading,
    SpeedReadings,
    check_valid,
    counted,
    in_words,
    read_counters,
    watch,
)
from canfb.master.samples import UPLOAD_PART, TrackSamples, listen, record
from canfb.master.session import Session, SupervisionLimits, write_limits
from canfb.objects import Multiplexer, StatusBit
from canfb.rows import Result
from canfb.view.module_view import coarse_layout

Values = Mapping[Multiplexer, float]
RANGES = (
    ("seconds", 0.1, 3600.0),
    ("margin", 1.2, 10.0),
    ("acceleration", 0.0, 1e9),
    ("watch_s", 0.1, 3600.0),
)


def set_limits(
    module: NodeAccess,
    before: Values,
    new: Values,
    watched: Callable[[], None],
    guard: Guard,
    *,
    keep: bool = False,
    step: Callable[[str], None] = lambda text: None,
) -> str | None:
    """Write ``new``, let ``watched`` judge, save if ``keep``: the object that saved.

    CommissioningError if anything does not work; then, and after an interruption, ``before`` is in force
    again, saved as well if saving had begun.
    """

    def act() -> None:
        step("writing the limits")
        write_limits(module, new)
        step("watching the machine with the new limits")
        watched()

    return change(
        module,
        guard,
        act,
        lambda: write_limits(module, before),
        what="the limits from before",
        undone=lambda: f"the limits from before are in force in {module.name}{_position(module)}",
        keep=keep,
        step=step,
    )


def _position(module: NodeAccess) -> str:
    try:
        status = module.integer(*od.FEEDBACK_STATUS, "H")
    except CanfbError:
        return ""
    return "; its position is lost, start it again at standstill" if status & StatusBit.LOST else ""


@dataclass(frozen=True, kw_only=True)
class CommissionOptions:
    """The options of ``canfb commission``; ``recording``: samples of 2050h; ``line``: the command."""

    seconds: float = 60.0
    margin: float = 2.0
    acceleration: float = 0.0
    recording: bool = False
    write: bool = False
    save: bool = False
    watch_s: float = 10.0
    out: Path | None = None
    line: str = ""

    def refuse_impossible(self) -> None:
        refuse_beyond(self, RANGES)


def commission(
    master: Master,
    module: int,
    interface: int | None,
    wishes: CommissionOptions,
    guard: Guard,
    steps: Steps,
    date: str,
) -> Result:
    """The command. ``interface`` None: read from the module; ``date`` as for :meth:`.Provenance.of_run`."""
    steps.step("reading the module")
    session = Session.open(master, module, interface)
    node = session.module
    if session.active.table is None:
        raise CommissioningError(
            f"{node.name}: no correction table is active, and without one the limits would be those of "
            "its errors: run canfb calibrate first"
        )
    limits = SupervisionLimits.read(node)
    if wishes.write:
        check_unlocked(node)
    if wishes.save:
        check_can_save(node)
    check_valid(node)
    counters, began_s = read_counters(node), master.now()
    steps.step(f"listening to the machine for {wishes.seconds:g} s: let it do its normal duty")
    samples, readings = _collect(session, wishes, steps)
    usual, usual_s = counted(counters, read_counters(node)), master.now() - began_s
    steps.step(f"calculating from {len(samples)} samples")
    observed = observe(samples, session.active, limits, readings)
    choices = choose(observed.machine, limits, wishes.margin, wishes.acceleration)
    new = limits.changed({one.place: one.value for one in choices})
    _prove(observed, new)
    changes = [one for one in choices if one.changes]
    saved_as = None
    if wishes.write and changes:
        saved_as = set_limits(
            node,
            {one.place: one.before for one in changes},
            {one.place: one.value for one in changes},
            lambda: watch(node, wishes.watch_s, usual, usual_s, steps.part),
            guard,
            keep=wishes.save,
            step=steps.step,
        )
    steps.clear()
    written = bool(wishes.write and changes)
    done = Commissioned(
        observed,
        limits,
        new,
        choices,
        usual,
        wishes.margin,
        written,
        wishes.write,
        saved_as,
        session.provenance(Provenance.of_run(date, wishes.line)),
    )
    out = wishes.out
    paths = [write_page(out, done), keep_samples(out, done.observed.samples)] if out else []
    return findings(done).result(paths)


def _collect(
    session: Session, wishes: CommissionOptions, steps: Steps
) -> tuple[TrackSamples, list[SpeedReading]]:
    readings = SpeedReadings(session.module)
    if not wishes.recording:
        layout = replace(session.layout(), coarse=coarse_layout(session.module.read_known))
        samples = listen(session.master, layout, wishes.seconds, LEAST_SAMPLES, steps.part, readings)
        return samples, readings.found
    found: list[SpeedReading] = []

    def progress(part: float) -> None:
        steps.part(part)
        if part < UPLOAD_PART:  # else the upload is on its way
            at = session.module.integer(*od.RECORDING_RECORDED, "I")
            speed = readings.read()
            if at:
                found.append(SpeedReading(at - 1.0, speed))

    return record(session.module, wishes.seconds, None, progress), found


def _prove(observed: Observation, new: SupervisionLimits) -> None:
    again = supervise(
        observed.samples, observed.used, new.chain_limits(observed.machine.interval_s), observed.start_speed
    )
    before = observed.followed.flagged
    more = {name: count for name, count in again.flagged.items() if count > before.get(name, 0)}
    if more:
        raise CommissioningError(
            f"the limits would flag samples of this very measurement ({in_words(more)}): set a larger "
            "--margin, and look at the samples that are far from all others"
        )
