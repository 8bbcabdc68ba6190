"""New limits in a module: written, read back, watched, saved; or those from before."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from canfb import objects as od
from canfb.commissioning.access import CommissioningError, NodeAccess
from canfb.commissioning.active import save, saving_object
from canfb.commissioning.guard import Guard
from canfb.commissioning.supervision_limits import write_limits
from canfb.commissioning.undoing import all_or_nothing, put_back
from canfb.errors import CanfbError
from canfb.objects import Multiplexer, StatusBit

Values = Mapping[Multiplexer, float]


def check_can_save(module: NodeAccess) -> None:
    """CommissioningError if the module cannot save."""
    if saving_object(module) is None:
        raise CommissioningError(
            f"--save: {module.name} cannot save (1010h; canfb run needs a state_dir for it)"
        )


def set_limits(
    module: NodeAccess,
    before: Values,
    wanted: Values,
    watched: Callable[[], None],
    guard: Guard,
    *,
    keep: bool = False,
    step: Callable[[str], None] = lambda text: None,
) -> str | None:
    """Write ``wanted``, let ``watched`` see whether that is good, save if ``keep``: the object that saved.

    ``before`` has the values of before of the same objects. CommissioningError if anything does not work,
    or ``watched`` raises it; these, and an interruption, leave the limits from before, saved as well if
    saving had begun.
    """
    saving = False

    def back() -> None:
        write_limits(module, before)
        if saving:
            save(module)

    def undo() -> str:
        put_back(module, "the limits from before", back, saving=saving)
        return f"the limits from before are in force in {module.name}{_position(module)}"

    with all_or_nothing(module, guard, undo):
        step("writing the limits")
        write_limits(module, wanted)
        step("watching the machine with the new limits")
        watched()
        if not keep:
            return None
        step("saving")
        saving = True
        return save(module)


def _position(module: NodeAccess) -> str:
    """A word where its position is lost."""
    try:
        status = module.integer(*od.FEEDBACK_STATUS, "H")
    except CanfbError:
        return ""
    return "; its position is lost, start it again at standstill" if status & StatusBit.LOST else ""
