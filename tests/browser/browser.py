"""A browser without a window, driven over Chrome's DevTools protocol through a pipe: nothing but Python is needed.

    test ── JSON, ended by a zero byte ──▶ file 3 of the browser
         ◀────────────────────────────── file 4
"""

import base64
import json
import os
import select
import shutil
import subprocess
import tempfile
import time

PROGRAMS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
ANSWER_S = 20.0


def find_program():
    """The path of a browser, or None where there is none. TENDON_BROWSER names one."""
    named = os.environ.get("TENDON_BROWSER")
    return named or next(filter(None, map(shutil.which, PROGRAMS)), None)


class Browser:
    """A running browser; a context that ends it."""

    def __init__(self, program):
        orders_read, self._orders = os.pipe()
        self._answers, answers_write = os.pipe()
        self._profile = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--remote-debugging-pipe", "--no-first-run",
                   f"--user-data-dir={self._profile.name}", "about:blank"]
        # The browser wants its pipe at files 3 and 4.
        self._process = subprocess.Popen(
            ["bash", "-c", f'exec "$0" "$@" 3<&{orders_read} 4>&{answers_write}', program, *options],
            pass_fds=(orders_read, answers_write), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(orders_read)
        os.close(answers_write)
        self._unread = b""
        self._next_id = 1
        self.events = []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.terminate()
        try:
            self._process.wait(5)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        os.close(self._orders)
        os.close(self._answers)
        self._profile.cleanup()

    @property
    def process_id(self):
        """Of its first process, from which all others come."""
        return self._process.pid

    def call(self, method, session=None, **parameters):
        """Gives one order and returns its result; raises RuntimeError where the browser refuses it."""
        order = {"id": self._next_id, "method": method, "params": parameters}
        self._next_id += 1
        if session is not None:
            order["sessionId"] = session
        os.write(self._orders, json.dumps(order).encode() + b"\0")
        deadline = time.monotonic() + ANSWER_S
        while True:
            message = self._read(deadline)
            if message.get("id") != order["id"]:
                self.events.append(message)
            elif "error" in message:
                raise RuntimeError(f"{method}: {message['error']['message']}")
            else:
                return message["result"]

    def _read(self, deadline):
        while b"\0" not in self._unread:
            ready, _, _ = select.select([self._answers], [], [], max(0.0, deadline - time.monotonic()))
            chunk = os.read(self._answers, 1 << 20) if ready else b""
            if not chunk:
                raise TimeoutError("the browser does not answer")
            self._unread += chunk
        message, self._unread = self._unread.split(b"\0", 1)
        return json.loads(message)

    def open(self, address, width=1280, height=800, is_dark=False):
        """A new tab of this size at an address."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        page = Page(self, session)
        page.call("Runtime.enable")
        page.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if is_dark else "light"}
        page.call("Emulation.setEmulatedMedia", features=[scheme])
        page.call("Page.navigate", url=address)
        page.wait_for("document.readyState === 'complete'")
        return page


class Page:
    """One tab."""

    def __init__(self, browser, session):
        self._browser = browser
        self._session = session

    def call(self, method, **parameters):
        return self._browser.call(method, self._session, **parameters)

    def value(self, expression):
        """The value of a JavaScript expression."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(f"{expression}: {answer['exceptionDetails']['exception'].get('description')}")
        return answer["result"].get("value")

    def text(self, selector):
        return self.value(f"document.querySelector({json.dumps(selector)})?.textContent ?? ''")

    def wait_for(self, expression, limit_s=15.0):
        """Waits until an expression is true; the watchdog's error says what the page shows instead."""
        deadline = time.monotonic() + limit_s
        while not self.value(expression):
            if time.monotonic() > deadline:
                shown = [self.text(part) for part in ("#standing-title", "#standing-detail", "#order-outcome")]
                raise AssertionError(f"not within {limit_s:.0f} s: {expression}; the page shows {shown}")
            time.sleep(0.03)

    def middle_of(self, selector):
        """Where the middle of an element is."""
        return self.value(f"(() => {{ const box = document.querySelector({json.dumps(selector)}).getBoundingClientRect();"
                          " return [box.x + box.width / 2, box.y + box.height / 2]; })()")

    def click(self, selector):
        """Presses and lets go the mouse in the middle of an element."""
        self.click_at(self.middle_of(selector))

    def click_at(self, place):
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=place[0], y=place[1], button="left", clickCount=1)

    def press(self, key, code, number, text=""):
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=key, code=code, windowsVirtualKeyCode=number,
                      text=text if kind == "keyDown" else "")

    def press_space(self):
        self.press(" ", "Space", 32, " ")

    def press_enter(self):
        self.press("Enter", "Enter", 13, "\r")

    def type(self, words):
        """Types letters and spaces, key by key, where the focus is."""
        for letter in words:
            if letter == " ":
                self.press_space()
            else:
                self.press(letter, f"Key{letter.upper()}", ord(letter.upper()), letter)

    def save_screenshot(self, path):
        with open(path, "wb") as file:
            file.write(base64.b64decode(self.call("Page.captureScreenshot")["data"]))

    def errors(self):
        """What went wrong in the scripts of this tab."""
        # Whatever was reported before this call has come.
        self.value("0")
        return [event["params"]["exceptionDetails"]["exception"].get("description") for event in self._browser.events
                if event.get("method") == "Runtime.exceptionThrown" and event.get("sessionId") == self._session]


if __name__ == "__main__":
    # Whether there is a browser, for scripts.
    if not find_program():
        raise SystemExit("no browser found: the tests of the page in a browser are skipped"
                         " (Debian: apt install chromium-headless-shell)")
