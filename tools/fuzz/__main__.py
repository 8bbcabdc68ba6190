"""Fuzz what comes from outside, with atheris: guided by the code of canfb that an input reaches.

    python -m tools.fuzz TARGET [LIBFUZZER OPTIONS]          needs atheris: pip install 'atheris>=3.0'
    python -m tools.fuzz TARGET --blind [OPTIONS]            without tracing: ten times as many inputs
    python -m tools.fuzz TARGET --play FILE...               inputs again, with the traceback

TARGET is `frames` (anything on the bus), `sdo` (transfers only), or `files`. Inputs that reach new code are
kept in build/fuzz/TARGET, where the next run begins. Useful options: -max_total_time=600 (seconds),
-runs=100000, -seed=1. The first input that breaks a rule ends the run and is left in
build/fuzz-TARGET-crash-...
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

TARGETS = ("frames", "sdo", "files")
LONGEST = {"frames": 400, "sdo": 400, "files": 1 << 15}
"""Bytes of an input."""
CORPUS_OF_FRAMES = Path(__file__).parents[2] / "tests" / "tools" / "fuzz_corpus.txt"
MEGABYTES = 1024
"""Of the whole process; bounds.py limits what one file takes."""
SECONDS = 60
"""For one input, of the clock; bounds.py limits the time of the processor."""
BUILD = Path("build")
UNTRACED = ["canfb.signal.*", "canfb.calibration.*"]
"""Read nothing from outside: an input runs faster when they are not traced."""


def kept_frames() -> list[bytes]:
    lines = CORPUS_OF_FRAMES.read_text(encoding="ascii").splitlines()
    return [bytes.fromhex(line.split()[0]) for line in lines if line and not line.startswith("#")]


def play(target: str, data: bytes, folder: Path) -> bool:
    """One input; False for a file that is refused. Raises what is found."""
    from tools.fuzz import body, files  # what it fuzzes, traced by then

    if target == "files":
        return files.play(data, folder)
    body.play(data, transfers_only=target == "sdo")
    return True


def fuzz(target: str, arguments: list[str], *, blind: bool) -> None:
    """Run until a find, or as long as the options of libFuzzer say. Does not return."""
    try:
        import atheris
    except ImportError:
        sys.exit("atheris is missing: python -m pip install 'atheris>=3.0'")
    import numpy as np  # noqa: F401  what is loaded before is not traced

    traced = atheris.instrument_imports(include=["canfb", "can", "canopen"], exclude=UNTRACED)
    with contextlib.nullcontext() if blind else traced:
        from tools.fuzz import files
    corpus = BUILD / "fuzz" / target
    corpus.mkdir(parents=True, exist_ok=True)
    seeds = files.seeds() if target == "files" else kept_frames()
    for seed in seeds:
        (corpus / hashlib.sha1(seed).hexdigest()).write_bytes(seed)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for seed in seeds:  # what is loaded with the first input is none of its doing
            play(target, seed, folder)

        def one(data: bytes) -> None:
            play(target, data, folder)

        limits = [f"-rss_limit_mb={MEGABYTES}", f"-timeout={SECONDS}", f"-max_len={LONGEST[target]}"]
        finds = f"-artifact_prefix={BUILD}/fuzz-{target}-"
        atheris.Setup([sys.argv[0], *limits, finds, *arguments, str(corpus)], one)
        atheris.Fuzz()


def again(target: str, path: Path) -> int:
    """Play an input again; exit code 1 for a find, whose traceback is printed."""
    from tools.fuzz import body

    data = path.read_bytes()
    if target != "files":
        print("\n".join(body.story(data, transfers_only=target == "sdo")))
    with tempfile.TemporaryDirectory() as folder:
        try:
            accepted = play(target, data, Path(folder))
        except BaseException:
            traceback.print_exc()
            return 1
    print(f"{path}: {'accepted' if accepted else 'refused'}")
    return 0


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(
        "python -m tools.fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("target", metavar="TARGET", choices=TARGETS)
    parser.add_argument("--blind", action="store_true", help="trace nothing")
    parser.add_argument("--play", type=Path, nargs="+", default=[], metavar="FILE", help="only these inputs")
    options, more = parser.parse_known_args(arguments)
    if options.play:
        return max(again(options.target, path) for path in options.play)
    fuzz(options.target, more, blind=options.blind)
    return 0


if __name__ == "__main__":
    logging.disable(logging.CRITICAL)
    sys.exit(main(sys.argv[1:]))
