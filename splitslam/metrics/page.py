"""/metrics over HTTP."""

from __future__ import annotations

from prometheus_client import CollectorRegistry, start_http_server

from splitslam.errors import InputError


class Page:
    """Served by a thread of its own until `close`."""

    def __init__(self, registry: CollectorRegistry, host: str, port: int) -> None:
        """port 0: any free one. Raises InputError when it cannot be had."""
        try:
            self._server, self._thread = start_http_server(port, host, registry)
        except OSError as error:
            raise InputError(f"metrics.port {port}: expected a free port on {host} ({error.strerror})") from None
        self.host, self.port = host, self._server.server_port

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
