"""One /metrics endpoint: read now and again, by anything that can go wrong put into words."""

from __future__ import annotations

import http.client
import time
import urllib.error
import urllib.request
from collections import deque
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from urllib.parse import urlsplit

from splitslam.errors import InputError
from splitslam.top.page import Page, Span

_TIMEOUT_S = 2.0
_LIMIT_BYTES = 8 << 20
WINDOW_S = 10.0  # what rates and quantiles are over


class Endpoint:
    """`pages`: the last seconds of them. `problem`: why the last try gave none."""

    def __init__(self, address: str) -> None:
        """HOST:PORT, or a URL. Raises InputError."""
        url = address if "://" in address else f"http://{address}/metrics"
        try:
            parts = urlsplit(url)
            good = parts.scheme in ("http", "https") and parts.hostname and (parts.port or "://" in address)
        except ValueError:  # a port that is no number
            good = False
        if not good:
            raise InputError(f"splitslam top: {address}: expected HOST:PORT or a URL, e.g. 127.0.0.1:9464")
        self.address, self.url = address, url
        self.pages: deque[Page] = deque()
        self.problem: str | None = None

    def read(self) -> None:
        """One try."""
        try:
            with urllib.request.urlopen(self.url, timeout=_TIMEOUT_S) as answer:
                text = answer.read(_LIMIT_BYTES).decode()
            page = Page.parse(text, time.monotonic())
        except (OSError, http.client.HTTPException, ValueError) as error:
            self.problem = _in_words(error)
            return
        if not page.has("splitslam_"):
            self.problem = "not a SplitSLAM program"
            return
        self.problem = None
        self.pages.append(page)
        while len(self.pages) > 2 and self.pages[0].at_s < page.at_s - WINDOW_S:
            self.pages.popleft()

    @property
    def span(self) -> Span | None:
        """What rates are over: the last seconds, as far as they have been seen."""
        return self._since(0)

    @property
    def step(self) -> Span | None:
        """From the page before the last one to that."""
        return self._since(-2)

    def _since(self, index: int) -> Span | None:
        if not self.pages:
            return None
        return Span(self.pages[index] if len(self.pages) > 1 else None, self.pages[-1])


def read_all(endpoints: Iterable[Endpoint], pool: ThreadPoolExecutor) -> None:
    """All at once: one that does not answer keeps none of the others waiting."""
    list(pool.map(Endpoint.read, endpoints))


def _in_words(error: Exception) -> str:
    if isinstance(error, urllib.error.HTTPError):
        return f"HTTP {error.code}"
    reason = error.reason if isinstance(error, urllib.error.URLError) else error
    if isinstance(reason, TimeoutError):
        return f"no answer in {_TIMEOUT_S:g} s"
    if isinstance(reason, OSError):
        return (reason.strerror or str(reason)).lower()
    return "not a metrics page" if isinstance(error, (ValueError, http.client.HTTPException)) else str(reason)
