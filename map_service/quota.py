"""How much each site may store. At its quota a site is refused, loudly; what it has stored is never cut."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future

from map_service.catalog import Catalog
from map_service.config import QuotaConfig
from map_service.hello import RefusedError
from splitslam.wire import session_pb2 as pb


class SiteQuotas:
    """What the sites have stored, as the store said when it was last asked: `refresh` asks, `check` does not.

    Several replicas and workers fill a site; between two looks it may grow beyond its quota by what they map meanwhile.
    """

    def __init__(self, config: QuotaConfig, catalog: Catalog) -> None:
        self._config, self._catalog = config, catalog
        self._bytes: dict[str, int] = {}
        self._looked_s = time.monotonic()
        self._look: Future[None] | None = None

    @property
    def any(self) -> bool:
        """Is there any quota to keep?"""
        return bool(self._config.site_bytes or any(self._config.sites.values()))

    def limit(self, site_id: str) -> int:
        """Bytes; 0: none."""
        return self._config.sites.get(site_id, self._config.site_bytes)

    def refresh(self) -> None:
        """Raises StoreError."""
        self._bytes = self._catalog.bytes_by_site()

    def looked(self, run: Callable[[Callable[[], None]], Future[None]]) -> bool:
        """Is there news? Asks the store now and then by `run`, and waits for nothing. No look without a quota."""
        now_s = time.monotonic()
        if self._look is None:
            if self.any and now_s - self._looked_s >= self._config.every_s:
                self._look = run(self.refresh)
            return False
        if not self._look.done():
            return False
        failed = self._look.exception() is not None  # a store that is away is others' to report
        self._look, self._looked_s = None, now_s
        return not failed

    def check(self, site_id: str) -> None:
        """Raises RefusedError for a site at its quota."""
        limit, used = self.limit(site_id), self._bytes.get(site_id, 0)
        if limit and used >= limit:
            detail = f"site {site_id!r} has stored {used} bytes, its quota is {limit}: delete sessions or raise quota"
            raise RefusedError(pb.REFUSED_REASON_QUOTA, detail, round(self._config.retry_after_s * 1e3))
