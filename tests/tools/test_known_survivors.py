"""The changes known to change nothing: each still is one, and has its reason."""

from __future__ import annotations

from pathlib import Path

from tools.suite import mutate

ROOT = Path(__file__).parents[2]
LIST = ROOT / "tests" / "signal" / "known_survivors.txt"


def test_each_known_survivor_is_a_change_and_has_a_reason() -> None:
    lines = [line.split("  # ") for line in LIST.read_text(encoding="utf-8").splitlines()]
    modules = {name.split(" ")[0] for name, _ in lines}
    paths = [path for path in (ROOT / "src" / "canfb" / "signal").rglob("*.py") if path.stem in modules]
    changes = {name for path in paths for name in mutate.names(path)}
    assert [name for name, _ in lines if name not in changes] == []
    assert all(reason for _, reason in lines)
    assert len({name for name, _ in lines}) == len(lines)
