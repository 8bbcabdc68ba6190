"""Mutation testing: change the code in one small place at a time, and see whether the tests notice.

    python -m tools.suite.mutate FILE... [--allow LIST] [--jobs N] -- PYTEST_ARGS

FILE are modules below the folder src of the working directory. Each change (a comparison, an operator, a
constant, a condition, a returned value, a statement left out) is made in memory, in a process that runs
pytest with PYTEST_ARGS up to the first failure. A change that no test notices is a survivor, and is printed.
LIST names survivors that are known to change nothing, one per line, with the reason after two spaces and a #.
The exit status is 1 if there are others, 2 if the tests fail unchanged. Nothing is written to the disk.
"""

import argparse
import ast
import copy
import importlib.abc
import importlib.util
import math
import os
import resource
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterator
from importlib.machinery import ModuleSpec
from pathlib import Path
from typing import Any, NamedTuple

SOURCE = Path("src").resolve()
# Limits: tests that take longer than these, or more memory, have noticed the change.
ENDLESS_S, ENDLESS_FACTOR, BOUNDLESS_BYTES = 60, 5, 4 << 30
PAIRS = [
    (ast.Lt, ast.LtE), (ast.Gt, ast.GtE), (ast.Eq, ast.NotEq), (ast.Is, ast.IsNot), (ast.In, ast.NotIn),
    (ast.And, ast.Or), (ast.Add, ast.Sub), (ast.Mult, ast.Div), (ast.BitAnd, ast.BitOr),
]  # fmt: skip
SWAPPED: dict[type[ast.AST], type[ast.AST]] = dict(PAIRS) | {new: old for old, new in PAIRS}
SWAPPED |= {ast.FloorDiv: ast.Div, ast.Mod: ast.Mult, ast.Pow: ast.Mult, ast.LShift: ast.RShift}


class Mutant(NamedTuple):
    path: Path
    line: int
    name: str  # place and change, without the line number, which would change with other lines
    tree: ast.Module


def changes(node: ast.AST) -> Iterator[ast.AST]:
    if isinstance(node, ast.Compare):
        for place, operator in enumerate(node.ops):
            yield changed(node, ops=[*node.ops[:place], SWAPPED[type(operator)](), *node.ops[place + 1 :]])
    elif isinstance(node, (ast.BoolOp, ast.BinOp, ast.AugAssign)) and type(node.op) in SWAPPED:
        yield changed(node, op=SWAPPED[type(node.op)]())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.Not, ast.USub)):
        yield node.operand
    elif isinstance(node, ast.Constant) and isinstance(node.value, (bool, int, float)):
        value = node.value
        others = (not value,) if isinstance(value, bool) else (value + 1, value - 1)
        yield from (changed(node, value=other) for other in others)
        if isinstance(value, float) and value != 0.0:
            yield changed(node, value=value * 1.25)
    elif isinstance(node, (ast.If, ast.IfExp)):
        yield changed(node, test=ast.UnaryOp(ast.Not(), node.test))
    elif isinstance(node, ast.Return) and short(node) not in ("return", "return None"):
        yield changed(node, value=ast.Constant(None))
    is_docstring = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    if isinstance(node, (ast.Assign, ast.AugAssign, ast.Expr)) and not is_docstring:
        yield ast.Pass()


def changed(node: ast.AST, **fields: object) -> ast.AST:
    other = copy.copy(node)
    vars(other).update(fields)
    return other


Place = tuple[Any, Any, ast.AST, str]


def places(node: ast.AST, within: str = "") -> Iterator[Place]:
    """All places that may be changed: container, key, content, and name of the function."""
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list", "type_params"):
            continue
        holder: Any = value if isinstance(value, list) else vars(node)
        for key in range(len(value)) if isinstance(value, list) else [field]:
            child = holder[key]
            if not isinstance(child, ast.AST) or (
                isinstance(child, ast.Assign) and "__slots__" in short(child)
            ):
                continue
            yield holder, key, child, within
            inner = f"{within}.{child.name}".lstrip(".") if hasattr(child, "name") else within
            yield from places(child, inner)


def mutants(path: Path) -> list[Mutant]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = []
    for name, (holder, key, node, _), other in named_changes(path.stem, tree):
        holder[key] = other
        found.append(Mutant(path, getattr(node, "lineno", 0), name, copy.deepcopy(tree)))
        holder[key] = node
    return sorted(found, key=lambda mutant: mutant.line)


def named_changes(stem: str, tree: ast.Module) -> Iterator[tuple[str, Place, ast.AST]]:
    """Name, place and replacement of all changes of a module."""
    seen: Counter[str] = Counter()
    for place in list(places(tree)):
        *_, node, within = place
        for other in changes(node):
            what = f"{stem} {within}: {short(node)} -> {short(other)}"
            seen[what] += 1
            yield what if seen[what] == 1 else f"{what} ({seen[what]})", place, other


def short(node: ast.AST) -> str:
    return " ".join(ast.unparse(ast.fix_missing_locations(copy.deepcopy(node))).splitlines()[0].split())


class Changed(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports the changed module instead of the real one."""

    def __init__(self, mutant: Mutant) -> None:
        self._name = ".".join(mutant.path.resolve().relative_to(SOURCE).with_suffix("").parts)
        self._code = compile(ast.fix_missing_locations(mutant.tree), str(mutant.path), "exec")

    def find_spec(self, fullname: str, path: object, target: object = None) -> ModuleSpec | None:
        return importlib.util.spec_from_loader(fullname, self) if fullname == self._name else None

    def exec_module(self, module: object) -> None:
        exec(self._code, vars(module))


def run_tests(mutant: Mutant | None, pytest_args: list[str], limit_s: int = 0) -> int:
    """Fork a process that runs the tests, with the change, if any, and exits with pytest's status; its PID.

    A signal ends it after ``limit_s`` seconds; 0: never.
    """
    pid = os.fork()
    if pid:
        return pid
    signal.alarm(limit_s)
    resource.setrlimit(resource.RLIMIT_AS, (BOUNDLESS_BYTES, BOUNDLESS_BYTES))
    status = 1
    try:
        import pytest

        if mutant is not None:
            for output in (1, 2):
                os.dup2(os.open(os.devnull, os.O_WRONLY), output)
            sys.meta_path.insert(0, Changed(mutant))
        sys.dont_write_bytecode = True
        status = int(pytest.main(["-x", "-q", "--no-header", "-p", "no:cacheprovider", *pytest_args]))
    finally:
        sys.stdout.flush()
        os._exit(status)


def survivors(every: list[Mutant], pytest_args: list[str], jobs: int, limit_s: int) -> list[Mutant]:
    waiting, survived = list(reversed(every)), []
    running: dict[int, Mutant] = {}
    while waiting or running:
        while waiting and len(running) < jobs:
            mutant = waiting.pop()
            running[run_tests(mutant, pytest_args, limit_s)] = mutant
        pid, status = os.wait()
        mutant = running.pop(pid)
        if status == 0:
            survived.append(mutant)
            print(f"{mutant.path}:{mutant.line}: {mutant.name}", flush=True)
    return survived


def main(arguments: list[str]) -> int:
    ours, pytest_args = arguments, []
    if "--" in arguments:
        at = arguments.index("--")
        ours, pytest_args = arguments[:at], arguments[at + 1 :]
    parser = argparse.ArgumentParser(
        prog="python -m tools.suite.mutate", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("files", nargs="+", type=Path, help="modules below src")
    parser.add_argument("--allow", type=Path, help="list of survivors that are known to change nothing")
    parser.add_argument("--jobs", type=int, default=2, help="processes at a time")
    options = parser.parse_args(ours)
    for path in options.files:
        if not (path.is_file() and path.resolve().is_relative_to(SOURCE)):
            parser.error(f"{path}: there is no such file below {SOURCE}")
    lines = options.allow.read_text(encoding="utf-8").splitlines() if options.allow else []
    allowed = {line.split("  #")[0].strip() for line in lines}
    begun_s = time.monotonic()
    if os.waitpid(run_tests(None, pytest_args), 0)[1]:
        print("the tests fail without any change", file=sys.stderr)
        return 2
    every = [mutant for path in options.files for mutant in mutants(path)]
    limit_s = max(ENDLESS_S, math.ceil(ENDLESS_FACTOR * (time.monotonic() - begun_s)))
    survived = survivors(every, pytest_args, options.jobs, limit_s)
    new = [mutant for mutant in survived if mutant.name not in allowed]
    print(f"{len(every)} changes, {len(survived)} survived, {len(new)} of them not known to change nothing")
    return 1 if new else 0


if __name__ == "__main__":
    for preloaded in ("numpy", "pytest"):  # so that child processes need not load them
        importlib.import_module(preloaded)
    sys.exit(main(sys.argv[1:]))
