"""Each room stays within its budget, which only falls (budget.toml)."""

from pathlib import Path

from tools.suite import size

# What a commit may leave unclaimed: small edits need not touch the budget, a deletion does.
SLACK = 0.02


def test_each_room_stays_within_its_budget_and_every_statement_has_one() -> None:
    """One test: to count all files takes longer than all else here."""
    rooms = size.rooms()
    above = [
        f"{room.name}: {room.size} {room.unit}, budget {room.budget}"
        for room in rooms
        if room.size > room.budget
    ]
    assert not above, "take something out"
    loose = [room.name for room in rooms if room.budget > room.size * (1 + SLACK)]
    assert not loose, "python -m tools.suite.size --lower"
    counted = sum(room.size for room in rooms if room.unit == "statements")
    files = (size.ROOT / "src").rglob("*.py")
    assert counted == sum(size.statements(file.read_text(encoding="utf-8")) for file in files)


def test_what_is_counted() -> None:
    text = '"""Two words."""\n\nx = 1; y = 2\n\n\ndef f() -> int:\n    """One."""\n    return x\n'
    assert size.statements(text) == 4  # x, y, def, return: however they are packed
    assert size.docstring_words(text) == 3


def test_lowering_never_raises(tmp_path: Path) -> None:
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "page.md").write_text("three words here\n", encoding="utf-8")
    (tmp_path / "tests").mkdir()
    (tmp_path / "tests" / "test_one.py").write_text("x = 1\ny = 2\n", encoding="utf-8")
    described = '[docs]\npaths = ["docs"]\nunit = "words"\nbudget = 9\ntarget = 1\n'
    described += '[tests]\npaths = ["tests"]\nunit = "lines"\nbudget = 1\ntarget = 1\n'
    (tmp_path / "budget.toml").write_text(described, encoding="utf-8")
    size.lower(tmp_path)
    assert [room.budget for room in size.rooms(tmp_path)] == [3, 1]
