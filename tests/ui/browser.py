# SPDX-License-Identifier: AGPL-3.0-or-later
"""A headless Chromium that a test drives: the DevTools protocol over two pipes, nothing else.

The browser has no network (a proxy that does not exist), a profile of its own, and draws in
software. `requests` and `said` are what it asked for and what its console said."""
import base64
import json
import os
import shutil
import subprocess
import tempfile
import time


def path():
    """Of Chromium, or None."""
    return shutil.which("chromium") or shutil.which("chromium-browser")


class Browser:
    def __init__(self, width, height, dark=False):
        self.profile = tempfile.TemporaryDirectory(prefix="gieson-chromium-",
                                                   ignore_cleanup_errors=True)
        ours, theirs = os.pipe(), os.pipe()  # what it says, what it is told

        def wire():  # it reads 3 and writes 4
            read, write = os.dup(theirs[0]), os.dup(ours[1])
            os.dup2(read, 3)
            os.dup2(write, 4)

        # The sandbox needs namespaces, which a container may not have.
        self.process = subprocess.Popen(
            [path(), "--headless=new", "--no-sandbox", "--remote-debugging-pipe",
             "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-sandbox",
             "--disable-dev-shm-usage", "--proxy-server=http://127.0.0.1:9", "--no-first-run",
             "--disable-background-networking", "--disable-component-update",
             "--hide-scrollbars", f"--user-data-dir={self.profile.name}",
             f"--window-size={width},{height}", "about:blank"],
            preexec_fn=wire, close_fds=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(ours[1])
        os.close(theirs[0])
        self.read, self.write = ours[0], theirs[1]
        self.left, self.number, self.session = b"", 0, None
        self.requests, self.said = [], []
        target = next(t for t in self.tell("Target.getTargets")["targetInfos"]
                      if t["type"] == "page")
        self.session = self.tell("Target.attachToTarget", targetId=target["targetId"],
                                 flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.tell(domain + ".enable")
        self.tell("Emulation.setDeviceMetricsOverride", width=width, height=height,
                  deviceScaleFactor=1, mobile=width < 600)
        self.tell("Emulation.setEmulatedMedia", features=[
            {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}])

    def close(self):
        for fd in (self.read, self.write):
            os.close(fd)
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        self.profile.cleanup()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    def _next(self):
        while b"\0" not in self.left:
            more = os.read(self.read, 1 << 20)
            if not more:
                raise RuntimeError("the browser is gone")
            self.left += more
        message, self.left = self.left.split(b"\0", 1)
        return json.loads(message)

    def _note(self, event):
        kind, about = event.get("method"), event.get("params", {})
        if kind == "Network.requestWillBeSent":
            self.requests.append(about["request"]["url"])
        elif kind == "Log.entryAdded":
            self.said.append(about["entry"]["text"])
        elif kind == "Runtime.consoleAPICalled":
            self.said.append(" ".join(str(a.get("value")) for a in about["args"]))
        elif kind == "Runtime.exceptionThrown":
            self.said.append(about["exceptionDetails"].get("exception", {}).get("description")
                             or about["exceptionDetails"]["text"])

    def tell(self, method, **params):
        self.number += 1
        message = {"id": self.number, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self.write, data):]
        while True:
            answer = self._next()
            if answer.get("id") != self.number:
                self._note(answer)
            elif "error" in answer:
                raise RuntimeError(f"{method}: {answer['error']}")
            else:
                return answer["result"]

    def open(self, file):
        self.tell("Page.navigate", url=f"file://{file}")
        self.until("document.readyState === 'complete'")

    def ask(self, expression):
        """The value of an expression in the page; a promise's when it is kept."""
        answer = self.tell("Runtime.evaluate", expression=expression, awaitPromise=True,
                           returnByValue=True)
        if "exceptionDetails" in answer:
            raise RuntimeError(answer["exceptionDetails"]["exception"]["description"])
        return answer["result"].get("value")

    def until(self, expression, seconds=60):
        end = time.monotonic() + seconds
        while not self.ask(expression):
            if time.monotonic() > end:
                raise RuntimeError(f"never came true: {expression}")
            time.sleep(0.05)

    def mouse(self, kind, x, y, **more):
        self.tell("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)

    def click(self, x, y):
        self.mouse("mouseMoved", x, y)
        for kind in ("mousePressed", "mouseReleased"):
            self.mouse(kind, x, y, button="left", buttons=int(kind == "mousePressed"), clickCount=1)

    def picture(self, file, selector=None):
        clip = {}
        if selector:
            box = self.ask(f"(b => [b.x + scrollX, b.y + scrollY, b.width, b.height])"
                           f"(document.querySelector('{selector}').getBoundingClientRect())")
            clip = {"clip": dict(zip(("x", "y", "width", "height"), box), scale=1)}
        data = self.tell("Page.captureScreenshot", captureBeyondViewport=False, **clip)
        with open(file, "wb") as out:
            out.write(base64.b64decode(data["data"]))
