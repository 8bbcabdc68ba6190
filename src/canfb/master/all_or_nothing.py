"""All of a change or the state from before: in a module, in a file, and under Ctrl-C."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from canfb.errors import CanfbError
from canfb.master.access import CommissioningError, NodeAccess
from canfb.master.active_table import STORES, save
from canfb.master.node_state import without_restart
from canfb.objects import Multiplexer


class Guard:
    """Keeps an interruption (Ctrl-C, SIGTERM, SIGHUP) away from what must not be left half done.

    Call :meth:`interrupt` from a signal handler: it raises KeyboardInterrupt, but not while held, and
    once only. A second signal, as a shell sends it to its jobs, must not stop what the first one began.
    """

    def __init__(self) -> None:
        self._held = self._interrupted = False

    def interrupt(self) -> None:
        """The end is requested."""
        if not self._held and not self._interrupted:
            self._interrupted = True
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """No interruption in here: what is done here is the end anyway."""
        self._held = True
        try:
            yield
        finally:
            self._held = False


PAUSE_S = 1.0  # before the second attempt: a bus that is away briefly, a node that starts
ATTEMPTS = 2


@contextlib.contextmanager
def all_or_nothing(module: NodeAccess, guard: Guard, undo: Callable[[], str]) -> Iterator[None]:
    """Whatever fails or interrupts the change in here, ``undo`` puts back what was; then the error goes on.

    A module that is restarted meanwhile counts as a failure: it has lost what was not saved.

    ``undo`` gives the words for that, and raises CanfbError where it does not work: the CommissioningError
    that comes of it says both. It is not interrupted.
    """
    try:
        with without_restart(module):
            yield
    except BaseException as error:
        with guard.held():
            try:
                said, undone = undo(), True
            except CanfbError as failure:
                said, undone = str(failure), False
        if isinstance(error, CanfbError) or not undone:
            raise CommissioningError(f"{str(error) or 'interrupted'}; {said}") from error
        raise


def change(
    module: NodeAccess,
    guard: Guard,
    act: Callable[[], None],
    back: Callable[[], None],
    *,
    what: str,
    undone: Callable[[], str],
    keep: bool = False,
    stores: Sequence[Multiplexer] = STORES,
    step: Callable[[str], None] = lambda text: None,
) -> str | None:
    """``act`` changes the module, and it is saved if ``keep``: the object that saved it, None: not saved.

    Whatever fails or interrupts this, ``back`` writes ``what`` was before, which is saved again where saving
    had begun; ``undone`` says that this is in force again. CommissioningError has the failure and this.
    """
    saving = False

    def restore() -> None:
        back()
        if saving:
            save(module, stores)

    def undo() -> str:
        put_back(module, what, restore, saving=saving)
        return undone()

    with all_or_nothing(module, guard, undo):
        act()
        if not keep:
            return None
        step("saving")
        saving = True
        return save(module, stores)


def put_back(module: NodeAccess, what: str, act: Callable[[], None], *, saving: bool = False) -> None:
    """``act`` writes ``what`` from before, and proves it; once more after a pause, if the bus fails.

    CommissioningError, which says how things stand and what to do, if that does not work either; with
    ``saving`` it may have been saved already.
    """
    for attempt in range(ATTEMPTS):
        try:
            if attempt:
                module.master.wait(PAUSE_S)
            with without_restart(module):
                act()
            return
        except CanfbError as error:
            if attempt < ATTEMPTS - 1:
                continue
            saved = (
                "either what was saved before or the new values, whole" if saving else "what is saved in it"
            )
            raise CommissioningError(
                f"{what} could not be put back ({error}): switch {module.name} off and on, which brings back "
                f"{saved}"
            ) from error


def write_whole(path: Path, data: bytes) -> None:
    """Write or replace a file. CommissioningError in one line; what was there before is there still.

    What is no plain file, as /dev/stdout or a pipe, is written to as it is.
    """
    try:
        if path.exists() and not path.is_file():
            _write_through(path, data)
        else:
            _replace(path, data)
    except OSError as error:
        raise CommissioningError(f"cannot write {path}: {error.strerror or error}") from None


def check_writable(path: Path) -> None:
    """CommissioningError where the file cannot be made, before any work is done for it."""
    if path.is_dir():
        raise CommissioningError(f"cannot write {path}: it is a folder")
    if not path.parent.is_dir():
        raise CommissioningError(f"cannot write {path}: there is no folder {path.parent}")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise CommissioningError(f"cannot write {path}: Permission denied")


def _write_through(path: Path, data: bytes) -> None:
    with path.open("wb") as file:
        file.write(data)


def _replace(path: Path, data: bytes) -> None:
    target = path.resolve()  # a link stays one
    handle, name = tempfile.mkstemp(prefix=f".{target.name}.", dir=target.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(name, target.stat().st_mode & 0o777 if target.exists() else 0o666 & ~_umask())
        os.replace(name, target)
    except BaseException:
        with contextlib.suppress(OSError):
            os.unlink(name)
        raise


def _umask() -> int:
    before = os.umask(0o022)
    os.umask(before)
    return before
