"""Drives Chromium through chromedriver by the WebDriver protocol. Standard library only."""

import base64
import json
import os
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request

ELEMENT = "element-6066-11e4-a52e-4f735466cecf"  # WebDriver's key of an element's reference
SHIFT, ENTER = "\ue008", "\ue007"
UP, RIGHT = "\ue013", "\ue014"
PAGE_UP, HOME = "\ue00e", "\ue011"


class BrowserError(Exception):
    pass


def is_installed():
    return bool(shutil.which("chromium") and shutil.which("chromedriver"))


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def wait_until(condition, seconds, what, every_s=.1):
    """The first true value of `condition()`. It is asked once more when the time is over."""
    deadline = time.monotonic() + seconds
    while True:
        late = time.monotonic() > deadline
        if value := condition():
            return value
        if late:
            raise AssertionError(f"not within {seconds} s: {what}")
        time.sleep(every_s)


class Browser:
    """One headless window, with a profile below `folder`."""

    def __init__(self, folder, patience=1, flags=()):
        self.patience = patience
        port = free_port()
        self.log = open(folder / "chromedriver.log", "wb")
        self.driver = subprocess.Popen([shutil.which("chromedriver"), f"--port={port}"], stdout=self.log,
                                       stderr=subprocess.STDOUT)
        self.base = f"http://127.0.0.1:{port}"
        self.session = ""
        try:
            wait_until(self.is_ready, 30 * patience, "chromedriver answers")
            self.session = f"/session/{self.ask('POST', '/session', capabilities(folder, flags))['sessionId']}"
        except BaseException:
            self.close()
            raise

    def is_ready(self):
        try:
            return self.ask("GET", "/status")["ready"]
        except OSError:
            return False

    def close(self):
        if self.session:
            try:
                self.ask("DELETE", "")
            except (OSError, BrowserError):
                pass
        self.driver.terminate()
        self.driver.wait()
        self.log.close()

    def ask(self, method, path, body=None):
        data = None if method != "POST" else json.dumps(body or {}).encode()
        request = urllib.request.Request(self.base + self.session + path, data=data, method=method,
                                         headers={"Content-Type": "application/json"})
        try:
            with urllib.request.urlopen(request, timeout=60 * self.patience) as reply:
                return json.load(reply)["value"]
        except urllib.error.HTTPError as error:
            with error:
                raise BrowserError(f"{method} {path}: {json.load(error)['value']['message']}") from None

    def open(self, url):
        self.ask("POST", "/url", {"url": url})

    def run(self, script, *arguments):
        """Value of a function's body in the page."""
        return self.ask("POST", "/execute/sync", {"script": script, "args": list(arguments)})

    def text(self, selector):
        return self.run("return document.querySelector(arguments[0])?.textContent ?? null", selector)

    def click(self, selector):
        self.ask("POST", f"/element/{self.find(selector)}/click")

    def find(self, selector):
        return self.ask("POST", "/element", {"using": "css selector", "value": selector})[ELEMENT]

    def type_into(self, selector, text):
        """In place of what stands there."""
        self.run("const e = document.querySelector(arguments[0]); e.focus(); e.select()", selector)
        self.keys(text)

    def keys(self, keys, held=""):
        """To what has the focus; `held` is down meanwhile."""
        strokes = [{"type": kind, "value": key} for key in keys for kind in ("keyDown", "keyUp")]
        if held:
            strokes = [{"type": "keyDown", "value": held}, *strokes, {"type": "keyUp", "value": held}]
        self.ask("POST", "/actions", {"actions": [{"type": "key", "id": "keyboard", "actions": strokes}]})

    def drag(self, *places, kind="mouse"):
        """Down at the first place, up at the last one; pixels of the window. One place is a click."""
        def move(place, ms):
            return {"type": "pointerMove", "duration": ms, "x": round(place[0]), "y": round(place[1])}
        steps = [move(places[0], 0), {"type": "pointerDown", "button": 0}]
        steps += [move(place, 150) for place in places[1:]] + [{"type": "pointerUp", "button": 0}]
        self.ask("POST", "/actions", {"actions": [
            {"type": "pointer", "id": kind, "parameters": {"pointerType": kind}, "actions": steps}]})
        self.ask("DELETE", "/actions")

    def devtools(self, command, **parameters):
        return self.ask("POST", "/goog/cdp/execute", {"cmd": command, "params": parameters})

    def resize(self, width, height, scale=1):
        self.devtools("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale,
                      mobile=width < 600)

    def prefer(self, scheme):
        """"dark" or "light"."""
        self.devtools("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])

    def console(self):
        """What the console said since the last call, violations of the content security policy included."""
        return self.ask("POST", "/se/log", {"type": "browser"})

    def screenshot(self, path):
        """Of the whole page, not only what the window shows."""
        shot = self.devtools("Page.captureScreenshot", format="png", captureBeyondViewport=True)
        path.write_bytes(base64.b64decode(shot["data"]))


def capabilities(folder, more_flags):
    flags = [*more_flags, "--headless=new", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars=false",
             "--window-size=1280,900", f"--user-data-dir={folder / 'chromium'}"]
    if os.geteuid() == 0:  # Chromium's sandbox refuses root
        flags.append("--no-sandbox")
    return {"capabilities": {"alwaysMatch": {
        "browserName": "chrome", "goog:loggingPrefs": {"browser": "ALL"},
        "goog:chromeOptions": {"binary": shutil.which("chromium"), "args": flags}}}}
