"""tools/bench/latency.py without a bus, and the picture of docs/latency.md."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest

from tools.bench import latency

ROOT = Path(__file__).parents[2]


def test_every_variant_answers_in_process(capsys: pytest.CaptureFixture[str]) -> None:
    assert latency.main(["--in-process", "--cycles", "20"]) == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| in process")]
    assert [row.split("|")[2].strip() for row in rows] == [
        latency.variant_name(*variant) for variant in latency.VARIANTS
    ]
    assert all(row.endswith("| 0 |") for row in rows)
    # At once: upon the ADC PDO. Synchronous: with the SYNC.
    assert [row.split("|")[3].strip() == "-" for row in rows] == [True, False, False, False]
    assert [row.split("|")[6].strip() == "-" for row in rows] == [False, True, True, True]


def test_a_table_has_median_99_of_100_and_the_largest() -> None:
    assert latency.spread([float(n) for n in range(1, 101)]) == "50 | 100 | 100"
    assert latency.spread([1.25]) == "1.2 | 1.2 | 1.2"
    assert latency.spread([]) == "- | - | -"


@pytest.mark.parametrize("wrong", [["--cycles", "0"], ["--rate", "0"], ["--rate", "nan"]])
def test_wrong_use_is_told(wrong: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        latency.main(["--in-process", *wrong])
    assert ended.value.code == 2


def test_the_picture_names_the_objects_as_text() -> None:
    picture = ElementTree.parse(ROOT / "docs" / "latency.svg")
    texts = " ".join(text for node in picture.iter() if (text := node.text))
    for name in ("6004h", "6008h", "2011:07", "6030h", "6040h", "2011:02", "6300h", "EMCY", "predict"):
        assert name in texts
    assert "prefers-color-scheme: dark" in texts
