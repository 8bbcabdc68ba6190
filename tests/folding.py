"""Many cases of one statement as one test: what pytest does around a test would cost more than the cases."""

import functools
import inspect
import itertools
from collections.abc import Callable, Iterable
from typing import Any

SHOWN = 20


def each(names: str, values: Iterable[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Like `pytest.mark.parametrize`, but all cases run in one test; several may be stacked.

    Every case is tried. When some fail, the test names them, and shows the traceback of the first. Fixtures
    are made once for all cases.
    """
    words, cases = tuple(names.replace(",", " ").split()), list(values)
    if not cases:
        raise ValueError(f"no case of {names}: nothing would be tested")

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        inner, axes = getattr(test, "folded", (test, ()))
        axes = ((words, cases), *axes)

        @functools.wraps(inner)
        def run(**fixtures: Any) -> None:
            combinations = [_together(axes, values) for values in itertools.product(*(a[1] for a in axes))]
            failed = [(case, error) for case in combinations if (error := _fault(inner, case, fixtures))]
            if failed:
                named = "\n".join(_line(case, error) for case, error in failed[:SHOWN])
                more = f"\n  and {len(failed) - SHOWN} more" if len(failed) > SHOWN else ""
                summary = f"{len(failed)} of {len(combinations)} cases fail:\n{named}{more}"
                raise AssertionError(summary) from failed[0][1]

        kept = [p for p in inspect.signature(test).parameters.values() if p.name not in words]
        del run.__dict__["__wrapped__"]  # pytest must see which fixtures are left
        run.__dict__.update(__signature__=inspect.Signature(kept), folded=(inner, axes))
        return run

    return decorate


def _together(axes: Iterable[tuple[tuple[str, ...], Any]], values: Iterable[Any]) -> dict[str, Any]:
    case: dict[str, Any] = {}
    for (words, _), value in zip(axes, values, strict=True):
        case |= zip(words, value if len(words) > 1 else (value,), strict=True)
    return case


def _fault(test: Callable[..., None], case: dict[str, Any], fixtures: dict[str, Any]) -> Exception | None:
    try:
        test(**fixtures, **case)
    except Exception as error:
        return error
    return None


def _line(case: dict[str, Any], error: Exception) -> str:
    values = ", ".join(f"{name}={value!r}" for name, value in case.items())
    said = f"{type(error).__name__}: {error}".splitlines()[0]
    return f"  {values}: {said}"
