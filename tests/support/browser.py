"""A page in headless Chromium, driven through the browser's own protocol (Chrome DevTools Protocol).

WebGL is drawn in software. Use `open_page` as a context manager.
"""

import contextlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import time
from urllib.request import urlopen

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from tests.support.ros_harness import INTERRUPTED_WITH_US, LONGEST, wait_for

PROGRAM = shutil.which("chromium-headless-shell")
OPTIONS = (
    "--no-sandbox",  # the tests may be root's
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--force-device-scale-factor=0.5",  # a quarter of the pixels to draw
    "--remote-debugging-port=0",
)
# as root, Chromium would give itself priority over the robot
NO_PRIORITY = ("setpriv", "--bounding-set=-sys_nice") if os.geteuid() == 0 else ()
FEW_PIXELS = "fixedDpr=0.3"  # viser would else try now and then how many it can draw, and stand still with too many
# Drawn in software, sixty frames a second would keep the cores from the robot. Each still waits for the browser's own
# turn to draw: frames that are ordered faster than they are drawn would hold the page up for minutes.
TEN_FRAMES_A_SECOND = """
const turn = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = draw => setTimeout(() => turn(draw), 100);
window.cancelAnimationFrame = clearTimeout;
"""


class Page:
    """One page. complaints: errors of its console, exceptions of its scripts, requests that failed."""

    def __init__(self, socket):
        self._socket, self._numbers, self.complaints = socket, itertools.count(1), []
        for domain in ("Page", "Runtime", "Log"):
            self.call(domain + ".enable")

    def call(self, method, **parameters):
        """The answer to one call of the protocol."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = self._take(LONGEST)
            if message.get("id") == number:
                assert "error" not in message, (method, message["error"])
                return message["result"]

    def look(self, seconds=0.0):
        """Hear what the page says for a while; returns its complaints."""
        end = time.monotonic() + seconds
        with contextlib.suppress(TimeoutError):
            while True:
                self._take(max(0.0, end - time.monotonic()))
        return self.complaints

    def _take(self, seconds):
        message = json.loads(self._socket.recv(seconds))
        what = message.get("params", {})
        if message.get("method") == "Runtime.exceptionThrown":
            self.complaints.append(what["exceptionDetails"]["text"])
        elif message.get("method") == "Log.entryAdded" and what["entry"]["level"] == "error":
            self.complaints.append("%(text)s %(url)s" % {"url": "", **what["entry"]})
        elif message.get("method") == "Runtime.consoleAPICalled" and what["type"] in ("error", "assert"):
            self.complaints.append(" ".join(str(a.get("value", a.get("description"))) for a in what["args"]))
        return message

    def evaluate(self, expression):
        """The value of a JavaScript expression."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    @property
    def text(self):
        """What can be read on the page."""
        return self.evaluate("document.body ? document.body.innerText : ''")

    def wait(self, *words):
        """Until all of these can be read on the page."""
        wait_for(lambda: all(word in self.text for word in words), "the page says %s" % (words,))

    def press(self, words, *expected):
        """Click on the element with exactly this text, and again where no other words can be read for some seconds.

        A page that is still being laid out misses clicks. A second click on a switch undoes the first one, whose effect
        takes a node on a busy machine some seconds.
        """

        def pressed():
            self._click("button, label, [role=tab], [role=option]", "e.textContent.trim() == %s" % json.dumps(words))
            again = time.monotonic() + 10.0
            while not any(each in self.text for each in expected) and time.monotonic() < again:
                self.look(0.2)
            return any(each in self.text for each in expected)

        wait_for(pressed, "%s after a click on %s" % (expected, words))

    def _click(self, *of):
        """Click on an element if it is there, as `_middle` finds it, and let the page answer."""
        found = self._middle(*of)
        if found:
            self.click(*found)
        self.look(0.5)

    def slide(self, label, share):
        """Click on the slider with this label, at a share of its length."""
        track = "const r = slider.parentElement.getBoundingClientRect(); return [r.x, r.width, r.y + r.height / 2]"
        left, width, y = self._slider(label, track)
        self.click(left + share * width, y)

    def _slider(self, label, then):
        """The value of JavaScript statements about the `slider` with this label."""
        return self.evaluate(
            "(() => { let e = [...document.querySelectorAll('label, p, div')].filter("
            "e => e.textContent.trim() == %s && e.getClientRects().length).at(-1);"
            "while (!e.querySelector('[role=slider]')) e = e.parentElement;"
            "const slider = e.querySelector('[role=slider]'); %s; })()" % (json.dumps(label), then)
        )

    def choose(self, now, then):
        """Choose another option where an input shows `now`."""
        shown, option = "e.value == %s" % json.dumps(now), "e.textContent.trim() == %s" % json.dumps(then)
        wait_for(lambda: then in self.text or self._click("input", shown), "the option %s" % then)
        self._click("[role=option]", option)

    def _middle(self, kind, holds):
        """Of the last visible element `e` of a kind for which a JavaScript expression holds; None where none does."""
        return self.evaluate(
            "(() => { const e = [...document.querySelectorAll(%s)].filter(e => %s && e.getClientRects().length).at(-1);"
            "if (!e) return null; e.scrollIntoView({block: 'nearest'}); const r = e.getBoundingClientRect();"
            "return [r.x + r.width / 2, r.y + r.height / 2]; })()" % (json.dumps(kind), holds)
        )

    def click(self, x, y):
        self._mouse("mouseMoved", x, y, button="none")
        self._mouse("mousePressed", x, y)
        self._mouse("mouseReleased", x, y)

    def _mouse(self, kind, x, y, button="left"):
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=1, clickCount=1)


@contextlib.contextmanager
def open_page(url, folder, width=1000, height=640):
    """A Page at `url`; `folder` (a Path) gets what the browser writes."""
    command = [*INTERRUPTED_WITH_US, *NO_PRIORITY, PROGRAM, *OPTIONS, "--window-size=%d,%d" % (width, height)]
    profile = folder / "profile"
    with open(folder / "browser.log", "wb") as log:
        browser = subprocess.Popen(
            [*command, "--user-data-dir=%s" % profile, "about:blank"], stdout=log, stderr=log, start_new_session=True
        )
    try:
        port = wait_for(lambda: _port(profile / "DevToolsActivePort"), "the browser")
        with urlopen("http://127.0.0.1:%d/json/list" % port) as answer:
            target = next(page for page in json.load(answer) if page["type"] == "page")
        # without pings: a page that draws in software on a busy machine answers them too late
        with connect(target["webSocketDebuggerUrl"], max_size=2**26, proxy=None, ping_interval=None) as socket:
            page = Page(socket)
            page.call("Page.addScriptToEvaluateOnNewDocument", source=TEN_FRAMES_A_SECOND)
            page.call("Page.navigate", url=url + ("&" if "?" in url else "?") + FEW_PIXELS)
            yield page
    except ConnectionClosed:
        raise AssertionError("the browser ended: %s" % (folder / "browser.log").read_text()) from None
    finally:
        os.killpg(browser.pid, signal.SIGKILL)  # the program is a script, whose children stay when it ends
        browser.wait(LONGEST)


def _port(file):
    with contextlib.suppress(OSError, IndexError):
        return int(file.read_text().splitlines()[0])
    return None
