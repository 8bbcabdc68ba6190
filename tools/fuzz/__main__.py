"""Fuzz what comes from outside, with atheris: guided by the code of canfb that an input reaches.

    python -m tools.fuzz TARGET [LIBFUZZER OPTIONS]          needs atheris: pip install 'atheris>=3.0'
    python -m tools.fuzz TARGET --blind [OPTIONS]            without tracing: ten times as many inputs
    python -m tools.fuzz TARGET --play FILE...               inputs again, with the traceback

TARGET is `frames` (anything on the bus), `sdo` (transfers only), or `files`. Inputs that reach new code are
kept in build/fuzz/TARGET, where the next run begins. Useful options: -max_total_time=600 (seconds),
-runs=100000, -seed=1. The first input that breaks a rule ends the run and is left in
build/fuzz-TARGET-crash-...
"""

import argparse
import contextlib
import hashlib
import logging
import sys
import tempfile
import traceback
from collections.abc import Callable
from pathlib import Path

from hypothesis import given, settings

LONGEST = {"frames": 2000, "sdo": 2000, "files": 1 << 15}
"""Bytes of an input, for each target."""
SEEDS = 100
"""Of frames: strategies make an input of any bytes."""
MEGABYTES = 1024
"""Of the whole process; bounds.py limits what one file takes."""
SECONDS = 60
"""For one input, of the clock; bounds.py limits the time of the processor."""
BUILD = Path("build")
UNTRACED = ["canfb.signal.*", "canfb.calibration.*"]
"""Read nothing from outside: an input runs faster when they are not traced."""


def player(
    target: str, folder: Path, show: Callable[[str], None] = lambda line: None
) -> Callable[[bytes], object]:
    """A function that plays the bytes of an input, and raises findings; `show` gets the input as text."""
    from tools.fuzz import body, files, inputs  # imported here, when tracing has begun

    if target == "files":
        return lambda data: show("accepted" if files.play(data, folder) else "refused")

    @settings(database=None, deadline=None)
    @given(inputs.INPUTS[target])
    def played(one: inputs.Input) -> None:
        show(str(one))
        body.play(one)

    fuzz_one_input: Callable[[bytes], object] = played.hypothesis.fuzz_one_input  # type: ignore[attr-defined]
    return fuzz_one_input


def fuzz(target: str, arguments: list[str], *, blind: bool) -> None:
    """Run until the first finding, or as the options of libFuzzer say. Does not return."""
    try:
        import atheris
    except ImportError:
        sys.exit("atheris is missing: python -m pip install 'atheris>=3.0'")
    import numpy as np  # imported before tracing begins, so not traced

    traced = atheris.instrument_imports(include=["canfb", "can", "canopen"], exclude=UNTRACED)
    with contextlib.nullcontext() if blind else traced:
        from tools.fuzz import files
    corpus = BUILD / "fuzz" / target
    corpus.mkdir(parents=True, exist_ok=True)
    long = (np.random.default_rng(n).bytes(LONGEST[target]) for n in range(SEEDS))
    for seed in files.seeds() if target == "files" else long:
        (corpus / hashlib.sha1(seed).hexdigest()).write_bytes(seed)
    with tempfile.TemporaryDirectory() as folder:
        one = player(target, Path(folder))
        for path in corpus.iterdir():  # imports caused by the first input must not count as its own
            one(path.read_bytes())
        limits = [
            "-len_control=0",
            "-keep_seed=1",  # keep the seeds, as without tracing none reaches new code
            f"-rss_limit_mb={MEGABYTES}",
            f"-timeout={SECONDS}",
            f"-max_len={LONGEST[target]}",
        ]
        finds = f"-artifact_prefix={BUILD}/fuzz-{target}-"
        atheris.Setup([sys.argv[0], *limits, finds, *arguments, str(corpus)], one)
        atheris.Fuzz()


def again(target: str, path: Path) -> int:
    """Play an input again; exit code 1 for a finding, with its traceback."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            player(target, Path(folder), lambda line: print(f"{path}: {line}"))(path.read_bytes())
        except BaseException:
            traceback.print_exc()
            return 1
    return 0


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(
        "python -m tools.fuzz", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("target", metavar="TARGET", choices=LONGEST)
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
