"""A person at the page: Chromium without a window, driven by selenium, and what can be seen in it."""

from __future__ import annotations

import base64
import json
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray
from selenium import webdriver
from selenium.common.exceptions import NoSuchElementException, StaleElementReferenceException
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
DESKTOP, PHONE = (1280, 800), (390, 844)
BLOCK = 256
ESCAPE, HOME = Keys.ESCAPE, Keys.HOME

_FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync", "--window-size=1280,800",
)  # fmt: skip

_CANVASES = """
const context = (canvas) => canvas.getContext("2d", {willReadFrequently: true});
const encode = (data) => { let text = ""; for (let k = 0; k < data.length; k += 8192)
  text += String.fromCharCode(...data.subarray(k, k + 8192)); return btoa(text); };
return [...document.querySelectorAll(arguments[0] + " canvas.cells")].map((canvas) =>
  [canvas.dataset.block, encode(context(canvas).getImageData(0, 0, canvas.width, canvas.height).data)]);
"""


class Viewer:
    """A browser that shows a page.

    Args:
        folder: for the browser's own files.
        shots: where pictures of the page are kept, or None.
        note_hosts: whether to note what is asked of whom; it makes a copy of all that comes, which takes time.
    """

    def __init__(self, folder: Path, shots: Path | None, *, note_hosts: bool = True) -> None:
        options = Options()
        options.binary_location = str(CHROMIUM)
        for flag in (*_FLAGS, f"--user-data-dir={folder}"):
            options.add_argument(flag)
        logs = {"browser": "ALL"} | ({"performance": "ALL"} if note_hosts else {})
        options.set_capability("goog:loggingPrefs", logs)
        self.driver = webdriver.Chrome(options=options, service=Service(str(DRIVER)))
        self._shots = shots
        self._asked: set[str] = set()

    def open(self, url: str, size: tuple[int, int] = DESKTOP, *, dark: bool = False) -> None:
        """Look at a page, on a screen of that size."""
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
        metrics = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": size == PHONE}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
        self.driver.get(url)

    def until(self, condition: Callable[[], Any], within: float) -> Any:
        """Look again and again; gives what the condition gave when it was first true."""
        deadline = time.monotonic() + within
        while True:
            try:
                if result := condition():
                    return result
            except (NoSuchElementException, StaleElementReferenceException):
                pass  # it has just been drawn anew, or the page is not there yet
            assert time.monotonic() < deadline, f"not so within {within} s"
            time.sleep(0.05)

    def find(self, selector: str) -> WebElement:
        """The element."""
        return self.driver.find_element(By.CSS_SELECTOR, selector)

    def all(self, selector: str) -> list[WebElement]:
        """All such elements."""
        return self.driver.find_elements(By.CSS_SELECTOR, selector)

    def click(self, selector: str) -> None:
        """Press it, wherever it is."""
        self.driver.execute_script(
            "arguments[0].scrollIntoView({block: 'center'}); arguments[0].click()", self.find(selector)
        )

    def click_at(self, selector: str, right: int, down: int) -> None:
        """Click so many pixels from the middle of something."""
        ActionChains(self.driver).move_to_element_with_offset(self.find(selector), right, down).click().perform()

    def press(self, key: str) -> None:
        """A key."""
        ActionChains(self.driver).send_keys(key).perform()

    def choose(self, selector: str, value: str) -> None:
        """Choose from a list."""
        script = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('change'))"
        self.driver.execute_script(script, self.find(selector), value)

    def type(self, selector: str, text: str) -> None:
        """Put a text into a field."""
        script = "arguments[0].value = arguments[1]; arguments[0].dispatchEvent(new Event('input'))"
        self.driver.execute_script(script, self.find(selector), text)

    def drag(self, selector: str, right: int, down: int) -> None:
        """Take something with the mouse and put it elsewhere, pixels away."""
        hand = ActionChains(self.driver, duration=40).move_to_element(self.find(selector)).click_and_hold()
        for _ in range(4):
            hand.move_by_offset(right // 4, down // 4)
        hand.move_by_offset(right - 4 * (right // 4), down - 4 * (down // 4)).release().perform()

    def shot(self, name: str) -> None:
        """Keep a picture."""
        if self._shots is not None:
            self.driver.save_screenshot(str(self._shots / f"{name}.png"))

    def pixels(self, layer: str, i0: int, j0: int, rows: int, columns: int) -> NDArray[np.uint8]:
        """What a layer's canvases show of a rectangle of cells, one canvas pixel a cell.

        Returns:
            RGBA, shape (rows, columns, 4), row 0 is south.
        """
        found = np.zeros((rows, columns, 4), np.uint8)
        for block, data in self.driver.execute_script(_CANVASES, layer):
            x, y, z = map(int, block.split(","))
            if z != 0:
                continue
            image = np.frombuffer(base64.b64decode(data), np.uint8).reshape(BLOCK, BLOCK, 4)[::-1]
            left, bottom = x * BLOCK - i0, -(y + 1) * BLOCK - j0
            c0, c1 = max(0, left), min(columns, left + BLOCK)
            r0, r1 = max(0, bottom), min(rows, bottom + BLOCK)
            if c0 < c1 and r0 < r1:
                found[r0:r1, c0:c1] = image[r0 - bottom : r1 - bottom, c0 - left : c1 - left]
        return found

    def complaints(self) -> list[str]:
        """What the browser's console says that is amiss."""
        return [entry["message"] for entry in self.driver.get_log("browser") if entry["level"] == "SEVERE"]

    def hosts_asked(self) -> set[str]:
        """Every host that anything was asked of since the browser was started."""
        for entry in self.driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            url = message["params"].get("request", {}).get("url") or message["params"].get("url", "")
            asked = urlsplit(url)
            sent = message["method"] in {"Network.requestWillBeSent", "Network.webSocketCreated"}
            if sent and asked.scheme in {"http", "https", "ws", "wss"}:  # chrome: is the browser's own
                self._asked.add(asked.netloc)
        return self._asked

    def close(self) -> None:
        """The browser goes."""
        self.driver.quit()


def shots_folder() -> Path | None:
    """Where ``ORION_SCREENSHOTS`` has pictures kept."""
    name = os.environ.get("ORION_SCREENSHOTS")
    if not name:
        return None
    folder = Path(name)
    folder.mkdir(parents=True, exist_ok=True)
    return folder
