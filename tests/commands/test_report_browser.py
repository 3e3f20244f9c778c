"""The report's page in a real browser: it opens, asks nothing of anybody, and its slider moves the scene."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.commands.conftest import run_here
from tests.commands.short_logs import write_short_log

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip


@pytest.fixture(scope="module")
def browser_path() -> str:
    found = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip(f"no browser here ({', '.join(BROWSERS)}); scripts/browser.sh installs one")
    return found


class Opened:
    """A page in a browser, and everything it complained about or asked for."""

    def __init__(self, context: Any, path: Path) -> None:
        self.page = context.pages[0]
        self.page.set_default_timeout(60_000)  # a loaded machine draws slowly
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(path.as_uri())
        self.wait_until("document.getElementById('clock').textContent !== '0.0 s'")
        self.page.wait_for_timeout(300)  # for the last word of the layout

    def wait_until(self, condition: str) -> None:
        """Asks again and again: the page's policy does not let the browser's driver leave a script to do so."""
        for _ in range(600):
            if self.page.evaluate(condition):
                return
            self.page.wait_for_timeout(100)
        raise AssertionError(f"never came true: {condition}")

    def set_time(self, t_ms: int) -> None:
        self.page.evaluate(
            "(t) => { const time = document.getElementById('time'); time.value = t;"
            " time.dispatchEvent(new Event('input')); }",
            t_ms,
        )

    def pixels(self, number: int = 0) -> str:
        """The scene's picture."""
        return str(self.page.evaluate("(n) => document.querySelectorAll('.scene canvas')[n].toDataURL()", number))

    def readout(self) -> str:
        return str(self.page.text_content(".readout"))


@pytest.fixture(scope="module")
def page_file(driven_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("browser") / "people.html"
    assert run_here("report", driven_run, "-o", path, "--no-figures").returncode == 0
    return path


@pytest.fixture(scope="module")
def driver() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        yield playwright


@contextmanager
def browser(driver: Any, executable: str, profile: Path, width: int, scheme: str) -> Iterator[Any]:
    context = driver.chromium.launch_persistent_context(
        profile,
        executable_path=executable,
        headless=True,
        args=list(FLAGS),
        viewport={"width": width, "height": 800},
        color_scheme=scheme,
    )
    yield context
    context.close()


@pytest.fixture(scope="module", params=[(1280, "light"), (360, "dark")], ids=["wide-light", "narrow-dark"])
def opened(
    request: pytest.FixtureRequest,
    driver: Any,
    browser_path: str,
    page_file: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Opened]:
    with browser(driver, browser_path, tmp_path_factory.mktemp("profile"), *request.param) as context:
        yield Opened(context, page_file)


def shows(opened: Opened, layer: str) -> bool:
    """Whether the scene is another without this layer, and the same again with it."""
    box = opened.page.get_by_label(layer, exact=True)
    with_it = opened.pixels()
    box.uncheck()
    without = opened.pixels()
    box.check()
    return without != with_it and opened.pixels() == with_it


def test_it_opens_without_a_complaint_or_a_request(opened: Opened, page_file: Path) -> None:
    assert opened.complaints == []
    assert opened.requests == [page_file.as_uri()]
    assert opened.page.evaluate("document.querySelectorAll('.uplot').length") >= 6


def test_it_does_not_run_over_the_windows_side(opened: Opened) -> None:
    wide, seen = opened.page.evaluate("[document.documentElement.scrollWidth, document.documentElement.clientWidth]")
    assert wide <= seen


def test_the_slider_moves_the_scene(opened: Opened) -> None:
    opened.set_time(0)
    first, words = opened.pixels(), opened.readout()
    opened.set_time(3000)
    assert "t = 3.0 s" in opened.readout()
    assert opened.readout() != words
    assert opened.pixels() != first
    opened.set_time(0)
    assert opened.pixels() == first


def test_the_slider_works_from_the_keyboard(opened: Opened) -> None:
    opened.set_time(1000)
    opened.page.focus("#time")
    opened.page.keyboard.press("ArrowRight")
    assert "t = 1.1 s" in opened.readout()
    opened.page.keyboard.press("PageUp")
    assert "t = 6.1 s" in opened.readout()


def test_playing_moves_the_time(opened: Opened) -> None:
    opened.set_time(0)
    opened.page.click("#play")
    opened.wait_until("Number(document.getElementById('time').value) > 200")
    opened.page.click("#play")
    assert opened.page.text_content("#play") == "Play"


@pytest.mark.parametrize("layer", ["tracks", "ellipses", "predictions", "reference", "plans", "driven paths", "labels"])
def test_each_layer_is_something_to_see(opened: Opened, layer: str) -> None:
    opened.set_time(3000)
    assert shows(opened, layer)


def test_points_and_clusters_of_scans_are_something_to_see(
    driver: Any, browser_path: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """A list of objects has none: this page is of a log with scans."""
    folder = tmp_path_factory.mktemp("scans")
    log = write_short_log(folder / "short.mcap", 6)
    assert run_here("cluster", log, "-o", folder / "run", "--range", "12").returncode == 0
    page = folder / "short.html"
    assert run_here("report", folder / "run", "-o", page, "--no-figures").returncode == 0
    with browser(driver, browser_path, folder / "profile", 1280, "light") as context:
        scanned = Opened(context, page)
        scanned.set_time(300)
        assert shows(scanned, "points")
        assert shows(scanned, "clusters")
        assert scanned.complaints == []


def test_a_planner_can_be_left_out_and_another_seed_chosen(opened: Opened) -> None:
    opened.set_time(3000)
    before = opened.pixels()
    opened.page.get_by_label("pure-pursuit", exact=True).uncheck()
    without = opened.pixels()
    assert without != before
    assert "pure-pursuit" not in opened.readout()
    opened.page.select_option("#seed", "1")
    assert opened.pixels() != without
    opened.page.select_option("#seed", "0")
    opened.page.get_by_label("pure-pursuit", exact=True).check()
    assert opened.pixels() == before


def test_the_scene_zooms_and_fits_again_by_keys(opened: Opened) -> None:
    opened.set_time(3000)
    fitted = opened.pixels()
    opened.page.focus(".scene canvas")
    opened.page.keyboard.press("+")
    opened.page.keyboard.press("ArrowLeft")
    assert opened.pixels() != fitted
    opened.page.keyboard.press("0")
    assert opened.pixels() == fitted


def test_the_policy_refuses_other_scripts_and_hosts(opened: Opened) -> None:
    """Were something foreign in the page in spite of all escaping, it could neither run nor call home."""
    refused = opened.page.evaluate(
        """async () => {
            const refused = [];
            const note = (event) => refused.push(event.effectiveDirective);
            document.addEventListener("securitypolicyviolation", note);
            const script = document.createElement("script");
            script.textContent = "window.ran = true";
            document.body.append(script);
            await fetch("http://127.0.0.1:9/").catch(() => null);
            await new Promise((done) => setTimeout(done, 50));
            document.removeEventListener("securitypolicyviolation", note);
            script.remove();
            return [...refused.sort(), String(window.ran)];
        }"""
    )
    assert refused == ["connect-src", "script-src-elem", "undefined"]
    opened.complaints.clear()


def test_nothing_went_wrong_meanwhile(opened: Opened, page_file: Path) -> None:
    assert opened.complaints == []
    assert opened.requests == [page_file.as_uri()]
