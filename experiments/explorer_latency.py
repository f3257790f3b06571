"""How long a move of a slider takes in `difftrb explore`: the solving alone, and in headless Chromium from the key to
new numbers in the page and to the end of drawing. Needs `pip install -e '.[browser]'`, Chromium and its driver.

`python -m experiments.explorer_latency`
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from statistics import median

import jax

jax.config.update("jax_enable_x64", True)

from bokeh.document import Document
from selenium import webdriver  # pyright: ignore[reportMissingImports]
from selenium.common.exceptions import WebDriverException  # pyright: ignore[reportMissingImports]
from selenium.webdriver.support.wait import WebDriverWait  # pyright: ignore[reportMissingImports]

import difftrb as trb
from difftrb.report import explorer

PORT, MOVES = 5127, 9
HANDLES = """
const found = [], walk = root => { for (const e of root.querySelectorAll('*')) {
  if (e.matches('.noUi-handle')) found.push(e); if (e.shadowRoot) walk(e.shadowRoot); } };
walk(document); return found;
"""
MOVE = """
const [handle, done] = arguments;
const source = [...Bokeh.documents[0]._all_models.values()].find(m => m.type == 'ColumnDataSource' && 'now' in m.data);
const start = performance.now();
const changed = () => {
  const there = performance.now() - start;
  source.properties.data.change.disconnect(changed);
  requestAnimationFrame(() => setTimeout(() => done([there, performance.now() - start]), 0));
};
source.properties.data.change.connect(changed);
handle.dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowRight', bubbles: true, cancelable: true}));
"""


def main() -> None:
    page = explorer.Explorer(explorer.checked(trb.load_scene("src/difftrb/scenes/spall.toml")), Document())
    solving = {}
    for name, slider in page.sliders.items():
        times = []
        for _ in range(MOVES):
            start = time.perf_counter()
            slider.value = min(slider.value + slider.step, slider.end)
            times.append(1e3 * (time.perf_counter() - start))
        solving[name] = median(times)
    options = webdriver.ChromeOptions()
    for argument in ("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--no-proxy-server"):
        options.add_argument(argument)
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    server = subprocess.Popen([sys.executable, "-m", "difftrb", "explore", "--no-browser", "--port", str(PORT)])
    try:
        wait = WebDriverWait(driver, 60, ignored_exceptions=[WebDriverException])
        wait.until(lambda _: driver.get(f"http://localhost:{PORT}/") is None)
        handles = wait.until(lambda _: len(found := driver.execute_script(HANDLES)) == 6 and found)
        time.sleep(3.0)
        print("medians [ms] | solving | numbers in the page | drawn")
        for name, handle in zip(page.sliders, handles, strict=True):
            times = []
            for _ in range(MOVES):
                times.append(driver.execute_async_script(MOVE, handle))
                time.sleep(1.0)  # what follows a move is over
            there, drawn = (median(each) for each in zip(*times, strict=True))
            print(f"{name:>12} | {solving[name]:7.1f} | {there:19.1f} | {drawn:5.1f}")
    finally:
        server.terminate()
        driver.quit()


if __name__ == "__main__":
    main()
