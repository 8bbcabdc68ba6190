"""The page in a real browser: each picture is drawn, it follows the module, and only this server is asked."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from chromium import Chromium
from processes import Process

PATIENCE_S = 180.0
PICTURES = ("position", "velocity", "residual", "amplitude", "faults", "deviation")
# How many pixels of a canvas are not empty.
DRAWN = """(() => { const one = document.querySelector('%s');
  const data = one.getContext('2d').getImageData(0, 0, one.width, one.height).data; let drawn = 0;
  for (let n = 3; n < data.length; n += 4) drawn += data[n] > 0; return drawn })()"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Chromium]:
    with Chromium(tmp_path_factory.mktemp("chromium")) as one:
        yield one


@pytest.fixture
def page() -> Iterator[Process]:
    process = Process((sys.executable, "-m", "canfb", "try"), PATIENCE_S)
    yield process
    process.stop()


def test_the_page(browser: Chromium, page: Process) -> None:
    address = page.wait_for("^open http").split()[1]
    server = address.partition("#")[0]
    browser.size(1400, 1900)
    browser.go(server)
    browser.wait_for(lambda: "Open the address that canfb has printed" in browser.text("#lost"), "refusal")
    browser.go(address)
    browser.wait_for(lambda: "with the active" in browser.text("#deviation"), "legend")
    browser.wait_for(lambda: "% rms" in browser.text("#curve"), "deviation of a machine that turns")
    assert browser.text("#curve").startswith("no table is active: ")
    assert browser.look("location.hash") == ""
    assert "node 32 (20h) OPERATIONAL" in browser.text("#name")
    assert "PDO mapping: module" in browser.text("#mapping")
    assert "valid" in browser.text("#lines")
    assert "lost" in browser.text("#counters")
    assert browser.look(DRAWN % "#tracks") > 1000
    for name in PICTURES:
        assert browser.look(DRAWN % f"#{name} canvas") > 500, name
    looks = browser.look("document.body.dataset.looks")
    browser.wait_for(lambda: browser.look("document.body.dataset.looks") != looks, "next look")
    colours = []
    for dark in (False, True):
        browser.size(1400, 1900, dark=dark)
        assert len(browser.picture()) > 50_000, "bytes: no empty page"
        colours.append(browser.look("getComputedStyle(document.body).backgroundColor"))
    assert colours == ["rgb(243, 245, 246)", "rgb(13, 17, 23)"]
    assert all(one.startswith((server, "data:")) for one in browser.addresses())
    assert [one for one in browser.complaints() if "403" not in one] == []
    page.stop()
    browser.wait_for(lambda: "The connection to canfb is lost" in browser.text("#lost"), "note at the end")


def test_a_narrow_window_has_no_bar_across(browser: Chromium, page: Process) -> None:
    browser.size(400, 800)
    browser.go(page.wait_for("^open http").split()[1])
    browser.wait_for(lambda: browser.look("Number(document.body.dataset.looks) > 1"), "looks")
    assert browser.look("document.documentElement.scrollWidth") <= 400
