"""One episode in full: what was planned, heard and sent."""

from __future__ import annotations

from tools.faults.wire.judge import ACCELERATION_ID, VALID
from tools.faults.wire.play import Episode, Played, play
from tools.faults.wire.setups import EMCY_ID

BITS = ("valid", "coasting", "lost", "residual", "amplitude", "clipped", "missed", "table", "referenced",
        "coarse", "calibrating", "frozen", "extrapolated", "other sensor")  # fmt: skip
BEFORE = 6  # slots before the fault that are shown


def words(status: int) -> str:
    """The bits of the status word by name."""
    return " ".join(name for bit, name in enumerate(BITS) if status >> bit & 1) or "-"


def trace(episode: Episode, every: bool) -> int:
    """Print it; 1 if a valid position was wrong."""
    played = play(episode, fresh=True)
    plan, verdict, motion = played.plan, played.verdict, played.plan.motion
    print(f"{episode}: {verdict.outcome}")
    print(f"  {plan.setup}\n  {plan.options}")
    print(f"  {motion.speed(plan.fault):.3f} cycles/T in slot {plan.fault}, SYNC at {plan.fault + 1} T")
    print(f"  pieces {[(round(a, 2), round(b, 4)) for a, b in motion.pieces]} vibrations {motion.vibrations}")
    kind = "sigma" if plan.gaussian else "+-"
    wire = f"jitter {kind} {plan.jitter_us:.1f} us, locked {plan.locked}, drift {plan.drift * 1e6:.0f} ppm"
    print(f"  {wire}, host {plan.host}")
    print(f"  stalls {plan.stalls} actions {plan.actions} {plan.note}")
    for number, slot in enumerate(plan.slots):
        if slot != type(slot)():
            print(f"  slot {number}: " + _changes(slot))
    if every:
        _frames(played)
    print(f"  {verdict}")
    return 1 if verdict.outcome == "wrong" else 0


def _changes(slot: object) -> str:
    default = type(slot)()
    return ", ".join(f"{k}={v}" for k, v in vars(slot).items() if v != getattr(default, k))


def _frames(played: Played) -> None:
    begin: float = played.plan.fault - BEFORE
    early = [
        one.now
        for one in played.judge.shown
        if not one.status & VALID or abs(one.error) > played.plan.tolerance
    ]
    begin = min([begin, *(at - BEFORE for at in early[:1])])
    shown = list(played.judge.shown)
    lines: list[tuple[float, int, str]] = []
    for event in played.line.events:
        data = event.frame.data.hex() if event.frame else ""
        lines.append((event.time, 0, f"> {event.what} {event.number} {data}"))
    for one in shown:
        mark = "WRONG" if one.status & VALID and abs(one.error) > played.plan.tolerance else ""
        what = f"    {one.what} {one.position:.3f} [{words(one.status)}]"
        lines.append((one.now, 1, f"{what} residual {one.residual:.3f} error {one.error:+.3f} {mark}"))
    others = [sent for sent in played.sent if sent.frame.can_id in (EMCY_ID, ACCELERATION_ID)]
    lines += [(one.now, 1, f"    {one.frame.can_id:03X} {one.frame.data.hex()}") for one in others]
    for at, _, text in sorted(lines, key=lambda line: line[:2]):
        if at >= begin:
            print(f"  {at:9.3f} {text}")
