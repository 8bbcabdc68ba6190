"""tools/bench/percentiles.py: nearest rank, and tables."""

from __future__ import annotations

import pytest

from tools.bench.percentiles import Percentiles, Table, cell


def test_each_percentile_is_a_value_that_so_many_do_not_exceed() -> None:
    found = Percentiles.of(float(n) for n in range(1000, 0, -1))
    assert (found.count, found.values) == (1000, (500.0, 990.0, 999.0, 1000.0))
    assert Percentiles.of([3.0]).values == (3.0,) * 4
    assert Percentiles.of([1.0, 2.0]).values == (1.0, 2.0, 2.0, 2.0)
    with pytest.raises(ValueError, match="no values"):
        Percentiles.of([])


def test_a_cell_has_two_digits_or_more() -> None:
    assert cell([1.25, 1.25, 12.34, 5678.9]) == "1.2 / 5679 / 5679 / 5679"
    assert cell([]) == "-"


def test_a_table_as_text_and_as_markdown() -> None:
    table = Table(["load", "SYNC"], [["alone", "7"], ["full", "1234"]])
    assert table.text() == "load   SYNC\nalone     7\nfull   1234"
    assert table.markdown() == "| load | SYNC |\n| --- | --- |\n| alone | 7 |\n| full | 1234 |"
