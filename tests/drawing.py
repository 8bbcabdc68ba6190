"""How many examples of a property are drawn."""

from typing import Any

from hypothesis import settings


def examples(count: int, **more: Any) -> settings:
    """``count`` where hypothesis draws 100 by itself: a half, in CI and ``make check`` fewer."""
    usual = settings.default
    assert usual is not None
    return settings(max_examples=max(5, count * usual.max_examples // 100), **more)
