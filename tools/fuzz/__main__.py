"""Fuzz what comes from outside, with atheris: guided by the code of canfb that an input reaches.

    python -m tools.fuzz TARGET [LIBFUZZER OPTIONS]          needs atheris: pip install 'atheris>=3.0'
    python -m tools.fuzz TARGET --blind [OPTIONS]            without tracing: ten times as many inputs
    python -m tools.fuzz TARGET --play FILE...               inputs again, with the traceback

Inputs that reach new code are kept in build/fuzz/TARGET, where the next run begins; the small files of
seeds.py are the first. Useful options: -max_total_time=600 (seconds), -runs=100000, -seed=1. The first input
that breaks a rule ends the run and is left in build/fuzz-TARGET-crash-...
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import logging
import sys
import tempfile
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tools.fuzz.targets import Target

MEGABYTES = 1024
"""Of the whole process; bounds.py limits what one input takes."""
SECONDS = 60
"""For one input, of the clock; bounds.py limits the time of the processor."""
BUILD = Path("build")
UNTRACED = ("signal", "calibration")
"""Rooms of canfb that read nothing from outside: an input runs faster when they are not traced."""


def modules_of(room: str) -> list[str]:
    """All modules of a room of canfb."""
    source = Path(__file__).resolve().parents[2] / "src"
    files = (source / "canfb" / room).rglob("*.py")
    return [".".join(path.relative_to(source).with_suffix("").parts) for path in files]


def target_of(name: str) -> Target:
    """The target of this name; loads what it fuzzes."""
    from tools.fuzz.targets import TARGETS

    if name not in TARGETS:
        sys.exit(f"no target {name}; there are {', '.join(TARGETS)}")
    return TARGETS[name]


def fuzz(name: str, arguments: list[str], *, blind: bool) -> None:
    """Run until a find, or as long as the options of libFuzzer say. Does not return."""
    try:
        import atheris
    except ImportError:
        sys.exit("atheris is missing: python -m pip install 'atheris>=3.0'")
    import numpy as np  # noqa: F401  what is loaded before is not traced

    exclude = [module for room in UNTRACED for module in modules_of(room)]
    traced = atheris.instrument_imports(include=["canfb", "can", "canopen"], exclude=exclude)
    with contextlib.nullcontext() if blind else traced:
        target = target_of(name)
    corpus = BUILD / "fuzz" / name
    corpus.mkdir(parents=True, exist_ok=True)
    seeds = target.seeds()
    for seed in seeds:
        (corpus / hashlib.sha1(seed).hexdigest()).write_bytes(seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"input{target.suffix}")
        target.accepts(path, seeds[0])  # what is loaded with the first input is none of its doing

        def one(data: bytes) -> None:
            target.accepts(path, data)

        limits = [f"-rss_limit_mb={MEGABYTES}", f"-timeout={SECONDS}", f"-max_len={target.longest}"]
        finds = f"-artifact_prefix={BUILD}/fuzz-{name}-"
        options: dict[str, Any] = {} if target.sealed is None else {"custom_mutator": _sealing(target.sealed)}
        atheris.Setup([sys.argv[0], *limits, finds, *arguments, str(corpus)], one, **options)
        atheris.Fuzz()


def _sealing(sealed: Any) -> Any:
    """A mutator that leaves the checksums right in most inputs."""
    import atheris

    def mutate(data: bytes, longest: int, seed: int) -> bytes:
        changed: bytes = atheris.Mutate(data, longest)
        return sealed(changed) if seed % 5 else changed

    return mutate


def play(name: str, path: Path) -> int:
    """Play an input again; exit code 1 for a find, whose traceback is printed."""
    target, data = target_of(name), path.read_bytes()
    if target.story is not None:
        print("\n".join(target.story(data)))
    with tempfile.TemporaryDirectory() as folder:
        try:
            accepted = target.accepts(Path(folder, f"input{target.suffix}"), data)
        except BaseException:
            traceback.print_exc()
            return 1
    print(f"{path}: {'accepted' if accepted else 'refused'}")
    return 0


def main(arguments: list[str]) -> int:
    """Fuzz, or play inputs; the exit code."""
    parser = argparse.ArgumentParser(
        "python -m tools.fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("target", metavar="TARGET", help="as in TARGETS of tools/fuzz/targets.py")
    parser.add_argument("--blind", action="store_true", help="trace nothing")
    parser.add_argument("--play", type=Path, nargs="+", default=[], metavar="FILE", help="only these inputs")
    options, more = parser.parse_known_args(arguments)
    if options.play:
        return max(play(options.target, path) for path in options.play)
    fuzz(options.target, more, blind=options.blind)
    return 0


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    sys.exit(main(sys.argv[1:]))
