"""Draw docs/images/cart.png: the web viewer with the full cart, as Chromium shows it.

python tools/docs/viewer_picture.py [FILE]

Needs the extra `browser` and Chromium with its driver, which draw without a display.
"""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

from PIL import Image
from selenium import webdriver
from selenium.common.exceptions import TimeoutException
from selenium.webdriver.support.wait import WebDriverWait

FILE = Path(__file__).parents[2] / "docs" / "images" / "cart.png"
SERVE = ("sim", "--port", "0", "--websocket-port", "0", "--camera-rate", "4")
PRESS = "[...document.querySelectorAll('button')].find(b => b.innerText === 'work').click()"
CLOSE = "document.querySelectorAll('[class*=Notification-closeButton]').forEach(b => b.click())"
#: Where the panel of measurements ends, in pixels of the picture.
PANEL = """
let right = 0;
for (let e = document.querySelector('[data-trocar=time]'); e; e = e.parentElement) {
  const box = e.getBoundingClientRect();
  if (box.width < innerWidth / 2) right = Math.max(right, box.right);
}
return Math.ceil(right * devicePixelRatio);
"""
#: The window [px], so wide that its panels leave the cart free, and its scale in the picture.
WINDOW, SCALE = "2060,1280", 0.62
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-angle=gl-egl",
    "--ignore-gpu-blocklist",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    f"--window-size={WINDOW}",
    f"--force-device-scale-factor={SCALE}",
)
#: Until all meshes are drawn in software, and until the arms have moved [s].
DRAWN_S, MOVED_S = 30.0, 12.0


def screenshot(url: str) -> Image.Image:
    """Return what a browser shows at an address, right of the measurements, with arms at work."""
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for flag in FLAGS:
        options.add_argument(flag)
    driver = shutil.which("chromedriver") or ""
    environment = {**os.environ, "LIBGL_ALWAYS_SOFTWARE": "1"}
    tab = webdriver.Chrome(options, webdriver.ChromeService(driver, env=environment))
    try:
        tab.get(url)
        shown = "return document.querySelector('[data-trocar=time]') !== null"
        wait = WebDriverWait(tab, 180.0, ignored_exceptions=[TimeoutException])
        wait.until(lambda _: tab.execute_script(shown))
        time.sleep(DRAWN_S)
        tab.execute_script(PRESS)
        time.sleep(MOVED_S)
        tab.execute_script(CLOSE)
        time.sleep(2.0)
        seen = Image.open(io.BytesIO(tab.get_screenshot_as_png())).convert("RGB")
        return seen.crop((tab.execute_script(PANEL), 0, *seen.size))
    finally:
        tab.quit()


def main(file: Path) -> None:
    """Serve the full cart and save its page."""
    command = [sys.executable, "-m", "trocar", *SERVE]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as served:
        try:
            lines = iter(served.stdout or ())
            url = next(found[0] for line in lines if (found := re.search(r"http://\S+", line)))
            picture = screenshot(url)
        finally:
            served.terminate()
    picture.quantize(256, kmeans=3).save(file, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FILE)
