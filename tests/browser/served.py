"""`jaxvibro view` as a process, and its page in Chromium."""

import os
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import sync_playwright

ROOT = Path(__file__).parents[2]
NAMES = ("chromium", "chromium-browser", "google-chrome")
MISSING = f"there is none of {', '.join(NAMES)} here: apt-get install chromium"
WAIT = 120_000  # ms: for compilation
# A page between two walls that needs only the branch of its first orbit.
SMALL = """[scene]
amplitude = 2.0
frequency = 2.1
damping = 0.05
restitution = 0.7
left.position = -1.0
right.position = 1.0

[branch]
parameter = "amplitude"
bounds = [0.0, 6.0]
start = {x = 0.9, v = -1.1}
"""
SAYS = "() => document.querySelector('header').innerText + document.getElementById('told').innerText"
PIXEL = """([name, x, y]) => {
    const area = document.getElementById(name).getBoundingClientRect();
    const [across, down] = panels[name].pixel([x, y]);
    return [area.left + across * area.width, area.top + down * area.height];
}"""


def find_chromium():
    """Return the path of a Chromium, None where there is none."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


@contextmanager
def chromium():
    """Provide a Chromium without a window."""
    root = ["--no-sandbox"] if hasattr(os, "getuid") and os.getuid() == 0 else []
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=find_chromium(), args=root)
        yield browser
        browser.close()


class Server:
    """The command on a scene file, in a process of its own, which ends with the context."""

    def __init__(self, scene, home, port=0):
        own = {"XDG_CACHE_HOME": str(home), "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-m", "jaxvibro", "view", str(scene), "--no-browser", "--port", str(port)]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        self.process = subprocess.Popen(command, cwd=home, env=os.environ | own, **pipes)
        self.url = self.process.stdout.readline().strip()
        if not self.url:
            raise RuntimeError(self.process.stderr.read())

    def __enter__(self):
        return self

    def __exit__(self, *_):
        """End the process as a crash would."""
        self.process.kill()
        self.process.communicate()


class Seen:
    """A page in a browser, and the errors that its console shows."""

    def __init__(self, browser, url, wait=True, width=1400):
        self.complaints = []
        self.context = browser.new_context(viewport={"width": width, "height": 900}, accept_downloads=True)
        self.page = self.context.new_page()
        self.page.set_default_timeout(WAIT)
        self.page.on("console", lambda line: line.type == "error" and self.complaints.append(line.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.goto(url)
        if wait:
            self.rest()

    def rest(self):
        """Wait until the page shows an orbit and no task runs."""
        self.until("jaxvibro.idle && jaxvibro.state.title && !jaxvibro.state.works.length")

    def until(self, condition):
        """Wait for a condition, which is evaluated from outside: the page itself evaluates no text."""
        end = time.monotonic() + WAIT / 1000
        while not self.page.evaluate(f"() => Boolean({condition})"):
            assert time.monotonic() < end, f"never true: {condition}; {self.page.evaluate(SAYS)}"
            self.page.wait_for_timeout(10)

    def state(self, key):
        """Return a field of the page."""
        return self.page.evaluate("(key) => jaxvibro.state[key]", key)

    def pixel(self, panel, x, y):
        """Return where a point of the axes of a panel is in the window."""
        return self.page.evaluate(PIXEL, [panel, x, y])

    def click(self, panel, x, y):
        """Click at a point of the axes of a panel, and wait for the result."""
        self.page.mouse.click(*self.pixel(panel, x, y))
        self.rest()

    def drag(self, first, last):
        """Drag from a point of the window to another."""
        self.page.mouse.move(*first)
        self.page.mouse.down()
        self.page.mouse.move(*last, steps=5)
        self.page.mouse.up()
        self.rest()

    def enter(self, name, value):
        """Type the value of a parameter, and wait for the result."""
        self.page.fill(f"#number_{name}", value)
        self.page.keyboard.press("Enter")
        self.rest()

    def take(self, name):
        """Return the content of a file of the page."""
        if self.page.get_attribute("#files", "open") is None:
            self.page.click("#files summary")
        with self.page.expect_download() as download:
            self.page.click(f"[data-take='{name}']")
        assert download.value.suggested_filename == name
        return Path(download.value.path()).read_bytes()

    def close(self):
        """Close the page, on which no error may have been shown."""
        self.context.close()
        assert self.complaints == []
