"""What no module can see: the few wire faults whose frames are those of a healthy machine.

P1  Neither SYNC counter, sample times nor receive times; module and interface hear nothing for n periods,
    n T no longer than the host may be late (LATEST_HOST_S). Proof: the module has frames, and the moments
    at which it was called. Take a healthy machine with the same frames, in the same order, n SYNCs fewer,
    whose host is later by n T from there on. That host is still no later than it may be, so it is healthy;
    its frames and moments are the same, its positions differ by n v. Whoever accepts one accepts both.
P3  No sample times; each PDO is late by one whole period from some slot on. Proof: the sample of slot k comes
    in interval k + 1, at its usual place in the interval. A machine of the same speed whose sample k was lost
    gives the same frames at the same times when the speed is a whole number of cycles per T; the positions
    differ by v. (At other speeds the residual tells them apart.)
"""

from __future__ import annotations

from wire_line import Plan

LATEST_HOST_S = 5e-3


def unseen(plan: Plan) -> str:
    """P1, P3, or nothing."""
    setup, slots = plan.setup, plan.slots
    if setup.times:
        return ""
    late = [n for n, slot in enumerate(slots) if slot.pdo_late_us * plan.us >= 1.0]
    if late and late == list(range(late[0], len(slots))):
        return "P3"
    if setup.counter or setup.stamps:
        return ""
    longest = run = 0
    for slot in slots:
        deaf = not slot.produced or (not slot.to_module and (slot.pdo_lost or not slot.to_interface))
        run = run + 1 if deaf else 0
        longest = max(longest, run)
    return "P1" if 0 < longest * plan.options.interval_s <= LATEST_HOST_S else ""
