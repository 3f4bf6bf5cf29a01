"""A headless Chromium under control: pages opened, pictures taken, frames counted. By DevTools' own pipe, no driver."""

from __future__ import annotations

import base64
import io
import itertools
import json
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# No GPU: ANGLE on its own rasteriser, or on Mesa's. Rerun takes WebGL 2 where there is no WebGPU.
_GL = ("--use-gl=angle", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")
_CALL_S, _STOP_S = 60.0, 5.0
# DevTools listens on 3 and answers on 4. Not by preexec_fn: other threads may run here.
_PIPES = (
    "import os, sys; ends = [os.dup(int(fd)) for fd in sys.argv[1:3]]; "
    "[os.dup2(end, to) for end, to in zip(ends, (3, 4))]; [os.set_inheritable(to, True) for to in (3, 4)]; "
    "os.execv(sys.argv[3], sys.argv[3:])"
)
# Before anything of the page runs. What is drawn goes through WebGL 2, what is shown comes by fetch.
_WATCH = """
(() => {
  const seen = window.splitslamSeen = {drawn: [], fresh: [], bytes: 0};
  let drew = false, shown = 0;
  for (const name of ["drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced"]) {
    const draw = WebGL2RenderingContext.prototype[name];
    WebGL2RenderingContext.prototype[name] = function (...args) { drew = true; return draw.apply(this, args); };
  }
  const read = ReadableStreamDefaultReader.prototype.read;
  ReadableStreamDefaultReader.prototype.read = function (...args) {
    const answer = read.apply(this, args);
    answer.then(({value}) => { seen.bytes += value?.byteLength ?? 0; }, () => {});
    return answer;
  };
  const frame = now => {
    if (drew) {
      seen.drawn.push(now);
      if (seen.bytes > shown) seen.fresh.push(now);
      shown = seen.bytes;
      drew = false;
    }
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
})()
"""
_FRAMES = """
new Promise(done => {
  const seen = window.splitslamSeen, before = seen.bytes;
  seen.drawn.length = seen.fresh.length = 0;
  setTimeout(() => done({drawn: seen.drawn, fresh: seen.fresh, bytes: seen.bytes - before}), %d);
})
"""


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """What a page has drawn within some time: frames in which it called WebGL to draw. All in s.

    fresh_s: those of them before which the page had received something since the frame before.
    """

    drawn_s: NDArray[np.float64]
    fresh_s: NDArray[np.float64]
    received_bytes: int


class ChromiumError(Exception):
    """It did not start, or did not answer."""


class Chromium:
    """One page. Every call raises ChromiumError when there is no answer in time."""

    def __init__(self, process: subprocess.Popen[bytes], to: int, back: int, log: Path) -> None:
        self._process, self._to, self._back, self._log = process, to, back, log
        self._numbers = itertools.count(1)
        self._buffer = b""
        self._session = ""
        target = self._call("Target.createTarget", {"url": "about:blank"})["targetId"]
        self._session = self._call("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
        self._call("Page.enable", {})
        self._call("Page.addScriptToEvaluateOnNewDocument", {"source": _WATCH})

    @property
    def pid(self) -> int:
        return self._process.pid

    def darken(self) -> None:
        """Pages that ask hear that people here like it dark."""
        dark = [{"name": "prefers-color-scheme", "value": "dark"}]
        self._call("Emulation.setEmulatedMedia", {"features": dark})

    def open(self, url: str) -> None:
        self._call("Page.navigate", {"url": url})

    def picture(self) -> NDArray[np.uint8]:
        """The page as it is now, (height, width, 3)."""
        from PIL import Image

        with Image.open(self._png()) as image:
            return np.asarray(image.convert("RGB"))

    def save(self, path: Path) -> None:
        """The page as it is now, as a PNG."""
        path.write_bytes(self._png().read())

    def _png(self) -> io.BytesIO:
        return io.BytesIO(base64.b64decode(self._call("Page.captureScreenshot", {"format": "png"})["data"]))

    def evaluate(self, script: str) -> Any:
        """The value of a JavaScript expression, waited for if it is a promise."""
        asked = {"expression": script, "returnByValue": True, "awaitPromise": True}
        answer = self._call("Runtime.evaluate", asked)
        if "exceptionDetails" in answer:
            raise ChromiumError(str(answer["exceptionDetails"].get("exception", answer["exceptionDetails"])))
        return answer["result"].get("value")

    def frames(self, seconds: float) -> Frames:
        """Of the next so many seconds. A page that draws nothing is called by its browser 60 times a second all the
        same: what is counted are frames in which it drew."""
        seen = self.evaluate(_FRAMES % int(seconds * 1e3))
        return Frames(np.array(seen["drawn"]) * 1e-3, np.array(seen["fresh"]) * 1e-3, int(seen["bytes"]))

    def _call(self, method: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
        number = next(self._numbers)
        message: dict[str, Any] = {"id": number, "method": method, "params": dict(parameters)}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        deadline_s = time.monotonic() + _CALL_S
        for answer in self._messages(deadline_s):
            if answer.get("id") == number:
                if "error" in answer:
                    raise ChromiumError(f"{method}: {answer['error']['message']}")
                return answer["result"]
        raise ChromiumError(f"{method}: no answer in {_CALL_S:g} s\n{self._log.read_text()[-2000:]}")

    def _messages(self, deadline_s: float) -> Iterator[dict[str, Any]]:
        while (left_s := deadline_s - time.monotonic()) > 0:
            message, found, rest = self._buffer.partition(b"\0")
            if found:
                self._buffer = rest
                yield json.loads(message)
            elif self._process.poll() is not None:
                raise ChromiumError(f"ended with {self._process.returncode}\n{self._log.read_text()[-2000:]}")
            elif select.select([self._back], [], [], min(left_s, 0.5))[0]:
                self._buffer += os.read(self._back, 1 << 20)


@contextmanager
def chromium(
    program: Path,
    size: tuple[int, int],
    environment: Mapping[str, str] | None = None,
    gl: str = "swiftshader",
) -> Iterator[Chromium]:
    """Started, and ended with the block. size: of the page, pixels. gl: what ANGLE draws with."""
    with tempfile.TemporaryDirectory(prefix="chromium-") as folder:
        log = Path(folder, "log")
        to_read, to_write = os.pipe()
        back_read, back_write = os.pipe()
        command = [
            *(str(program), "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--hide-scrollbars"),
            *(f"--user-data-dir={folder}/profile", f"--window-size={size[0]},{size[1]}", "--remote-debugging-pipe"),
            *("--no-first-run", "--disable-background-networking", "--disable-component-update", "--disable-sync"),
            *_GL,
            f"--use-angle={gl}",
        ]

        with log.open("wb") as out:
            process = subprocess.Popen(
                (sys.executable, "-ISc", _PIPES, str(to_read), str(back_write), *command),
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=out,
                env={**os.environ, **(environment or {})},
                pass_fds=(to_read, back_write),
            )
        os.close(to_read)
        os.close(back_write)
        try:
            yield Chromium(process, to_write, back_read, log)
        finally:
            process.terminate()
            try:
                process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            os.close(to_write)
            os.close(back_read)
