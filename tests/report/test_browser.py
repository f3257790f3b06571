"""The report's page and the live page in a headless Chromium; skipped where there is none."""

import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("bokeh", reason="needs Bokeh")
pytest.importorskip("selenium", reason="needs Selenium")

from selenium import webdriver
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.support.wait import WebDriverWait

DRIVER = shutil.which("chromedriver")
pytestmark = [pytest.mark.slow, pytest.mark.skipif(DRIVER is None, reason="needs Chromium and its driver")]

EVERY = """
const found = [], walk = root => { for (const e of root.querySelectorAll('*')) {
  if (e.matches(arguments[0])) found.push(e); if (e.shadowRoot) walk(e.shadowRoot); } };
walk(document); return found;
"""
"""All elements of a kind, those in shadow trees, too."""
DRAWN = """
const sources = [...Bokeh.documents[0]._all_models.values()].filter(m => m.type == 'ColumnDataSource');
const names = ['spalled', 'spalled_radial', 'now'];
return JSON.stringify(sources.map(s => names.map(name => Array.from(s.data[name] || []))));
"""
"""Numbers that are drawn, of rollers and of the cage's turn."""
TEXTS = "return [...Bokeh.documents[0]._all_models.values()].filter(m => m.type == 'Div').map(m => m.text).join()"


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    options = webdriver.ChromeOptions()
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--no-proxy-server"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    yield driver
    driver.quit()


def complaints(browser: Any) -> list[str]:
    return [line["message"] for line in browser.get_log("browser") if line["level"] == "SEVERE"]


@pytest.mark.parametrize("width", [420, 1400])
def test_the_report_fits_the_window_and_draws_every_figure(browser: Any, tmp_path: Path, width: int) -> None:
    subprocess.run([sys.executable, "-m", "difftrb", "run", "--out", str(tmp_path)], check=True, capture_output=True)
    page = tmp_path / "report.html"
    assert page.stat().st_size < 2e6
    browser.set_window_size(width, 900)
    browser.get(page.as_uri())
    assert not complaints(browser)
    drawn = [svg.rect for svg in browser.find_elements("css selector", "section svg")]
    assert len(drawn) == 5
    assert all(rect["width"] > 200.0 and rect["height"] > 50.0 for rect in drawn)
    wide, window = browser.execute_script("return [document.documentElement.scrollWidth, window.innerWidth]")
    assert wide <= window


def test_the_live_page_follows_the_keyboard(browser: Any) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "difftrb", "explore", "--no-browser", "--port", str(port)]
    server = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        for _ in range(300):
            with socket.socket() as tried:
                if tried.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.2)
        browser.set_window_size(1400, 1000)
        browser.get(f"http://localhost:{port}/")
        wait = WebDriverWait(browser, 60)
        wait.until(lambda page: len(page.execute_script(EVERY, ".noUi-handle")) == 6)
        wait.until(lambda page: "by length" in page.execute_script(TEXTS))
        seen, table = [browser.execute_script(DRAWN)], browser.execute_script(TEXTS)
        for _ in range(6):  # every slider is reached by Tab and moved by an arrow
            browser.switch_to.active_element.send_keys(Keys.TAB, Keys.ARROW_RIGHT)
            wait.until(lambda page: page.execute_script(DRAWN) not in seen)
            seen.append(browser.execute_script(DRAWN))
        wait.until(lambda page: page.execute_script(TEXTS) != table)
        assert not complaints(browser)
    finally:
        server.terminate()
        said = server.communicate()[0]
    assert "Traceback" not in said, said
    assert "ERROR" not in said, said
