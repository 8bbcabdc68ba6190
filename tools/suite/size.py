"""Print the size of each room, with its budget and its target (budget.toml).

python -m tools.suite.size
python -m tools.suite.size --lower      lower each budget to the present size, after deleting
"""

import ast
import re
import sys
import tomllib
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
WITH_DOCSTRING = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass(frozen=True)
class Room:
    name: str
    unit: str
    size: int
    budget: int
    target: int


def docstrings_of(tree: ast.Module) -> list[ast.Expr]:
    with_one = (
        node for node in ast.walk(tree) if isinstance(node, WITH_DOCSTRING) and ast.get_docstring(node)
    )
    return [node.body[0] for node in with_one if isinstance(node.body[0], ast.Expr)]


def statements(text: str) -> int:
    tree = ast.parse(text)
    return sum(isinstance(node, ast.stmt) for node in ast.walk(tree)) - len(docstrings_of(tree))


def docstring_words(text: str) -> int:
    return sum(len(ast.literal_eval(each.value).split()) for each in docstrings_of(ast.parse(text)))


# For each unit: the files, and the function that counts in the text of one file.
MEASURES = {
    "statements": ("*.py", statements),
    "docstring words": ("*.py", docstring_words),
    "lines": ("*.py", lambda text: text.count("\n")),
    "words": ("*.md", lambda text: len(text.split())),
}


def rooms(root: Path = ROOT) -> list[Room]:
    """The rooms of budget.toml, in its order; a file belongs to the longest path that contains it."""
    described = tomllib.loads((root / "budget.toml").read_text(encoding="utf-8"))
    sizes: defaultdict[str, int] = defaultdict(int)
    for unit, (pattern, measure) in MEASURES.items():
        places = {
            path: name for name, room in described.items() if room["unit"] == unit for path in room["paths"]
        }
        for top in {path.split("/")[0] for path in places}:
            for file in (root / top).rglob(pattern):
                inside = file.relative_to(root)
                holding = [path for path in places if inside.is_relative_to(path)]
                if holding:
                    sizes[places[max(holding, key=len)]] += measure(file.read_text(encoding="utf-8"))
    return [
        Room(name, room["unit"], sizes[name], room["budget"], room["target"])
        for name, room in described.items()
    ]


def sums(of: list[Room]) -> list[Room]:
    """The rooms; those that count statements are followed by their sum, `src`."""
    counted = [room for room in of if room.unit == "statements"]
    size, budget, target = (
        sum(getattr(room, what) for room in counted) for what in ("size", "budget", "target")
    )
    return [*counted, Room("src", "statements", size, budget, target), *of[len(counted) :]]


def lower(root: Path = ROOT) -> None:
    file = root / "budget.toml"
    text = file.read_text(encoding="utf-8")
    for room in rooms(root):
        if room.size < room.budget:
            text = re.sub(rf"(?s)(\[{room.name}\].*?\nbudget = )\d+", rf"\g<1>{room.size}", text, count=1)
    file.write_text(text, encoding="utf-8")


def main() -> None:
    if sys.argv[1:] == ["--lower"]:
        lower()
    print(f"{'room':<12} {'unit':<15} {'today':>7} {'budget':>7} {'target':>7}")
    for room in sums(rooms()):
        print(f"{room.name:<12} {room.unit:<15} {room.size:>7} {room.budget:>7} {room.target:>7}")


if __name__ == "__main__":
    main()
