"""A headless Chromium, driven by WebDriver over plain HTTP."""

import base64
import json
import shutil
import subprocess
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path

import pytest

PATIENCE_S = 120
MISSING = "needs Debian's chromium and chromium-driver: scripts/install-chromium.sh"
ELEMENT = "element-6066-11e4-a52e-4f735466cecf"
ARGUMENTS = (
    "--headless=new",
    "--no-sandbox",  # Chromium's own sandbox wants another user than root
    "--disable-dev-shm-usage",
    "--window-size=1280,1000",
)


class Browser:
    def __init__(self):
        if not (shutil.which("chromedriver") and shutil.which("chromium")):
            pytest.skip(MISSING)
        self.driver = subprocess.Popen(["chromedriver", "--port=0"], stdout=subprocess.PIPE, text=True)
        try:
            said = next(line for line in self.driver.stdout if "successfully on port " in line)
            self.root = f"http://127.0.0.1:{said.split('successfully on port ')[1].strip().rstrip('.')}/session"
            # Someone must go on reading, or it would block on a full pipe.
            threading.Thread(target=self.driver.stdout.read, daemon=True).start()
            wanted = {"browserName": "chrome", "goog:chromeOptions": {"args": list(ARGUMENTS)}}
            wanted["goog:loggingPrefs"] = {"browser": "ALL"}
            started = self.ask("", {"capabilities": {"alwaysMatch": wanted}})
            self.root += f"/{started['sessionId']}"
        except BaseException:
            self.driver.kill()
            raise

    def ask(self, path: str, body: dict | None = None, method: str | None = None):
        content = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(self.root + path, content, {"Content-Type": "application/json"}, method=method)
        try:
            with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:
                return json.load(answer)["value"]
        except urllib.error.HTTPError as error:
            raise AssertionError(json.load(error)["value"]["message"]) from None

    def close(self) -> None:
        try:
            self.ask("", method="DELETE")
        finally:
            self.driver.terminate()
            self.driver.wait()

    def open(self, url: str) -> None:
        self.ask("/url", {"url": url})

    def run(self, script: str, *arguments):
        """What a script returns."""
        return self.ask("/execute/sync", {"script": script, "args": list(arguments)})

    def until(self, expression: str):
        """Waits until an expression is true, and returns it."""
        started = time.monotonic()
        while not (value := self.run(f"return {expression};")):
            page = self.run("return document.body.innerText;")
            assert time.monotonic() - started < PATIENCE_S, f"never true: {expression}\n{page}"
            time.sleep(0.05)
        return value

    def text(self, css: str) -> str:
        return self.run("return document.querySelector(arguments[0]).innerText;", css)

    def find(self, css: str) -> str:
        return f"/element/{self.ask('/element', {'using': 'css selector', 'value': css})[ELEMENT]}"

    def click(self, css: str) -> None:
        self.ask(f"{self.find(css)}/click", {})

    def press(self, words: str) -> None:
        """Clicks a button by its words."""
        found = self.ask("/element", {"using": "xpath", "value": f"//button[normalize-space()='{words}']"})
        self.ask(f"/element/{found[ELEMENT]}/click", {})

    def control(self, label: str) -> str:
        return f"#{self.run(CONTROL, label)}"

    def value(self, label: str) -> str:
        return self.run("return document.querySelector(arguments[0]).value;", self.control(label))

    def fill(self, label: str, text: str) -> None:
        """Types into the field of a label, and leaves it."""
        field = self.find(self.control(label))
        self.ask(f"{field}/clear", {})
        self.ask(f"{field}/value", {"text": text + "\ue004"})

    def choose(self, label: str, words: str) -> None:
        self.click(f"{self.control(label)} option[value='{words}']")

    def drag(self, css: str, start: tuple[float, float], end: tuple[float, float]) -> None:
        """With the mouse, between places in an element, pixels of the screen from its upper left corner."""
        left, top = self.run(CORNER, css)
        points = [(round(left + x), round(top + y)) for x, y in (start, *between(start, end), end)]
        moves = [{"type": "pointerMove", "duration": 10, "x": x, "y": y} for x, y in points]
        press, let_go = ({"type": kind, "button": 0} for kind in ("pointerDown", "pointerUp"))
        mouse = {"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}}
        self.ask("/actions", {"actions": [{**mouse, "actions": [moves[0], press, *moves[1:], let_go]}]})

    def picture(self, path: Path) -> None:
        path.write_bytes(base64.b64decode(self.ask("/screenshot")))

    def complaints(self) -> list[str]:
        """What the browser complained of."""
        return [entry["message"] for entry in self.ask("/se/log", {"type": "browser"}) if entry["level"] == "SEVERE"]


CONTROL = (
    "const label = [...document.querySelectorAll('label')].find((one) => one.textContent.trim() === arguments[0]);"
    "return label.htmlFor;"
)
CORNER = (
    "const element = document.querySelector(arguments[0]); element.scrollIntoView({block: 'center'});"
    "const {left, top} = element.getBoundingClientRect(); return [left, top];"
)


def between(start, end, count: int = 4):
    return [tuple(a + (b - a) * k / (count + 1) for a, b in zip(start, end)) for k in range(1, count + 1)]
