"""Which sensors are there: a loss is said once, and so is the return."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from splitslam.logs import fields

_log = logging.getLogger(__name__)


class Presence:
    """When each sensor was last heard. losses: how often each has fallen silent."""

    def __init__(self, sensors: Sequence[str], silent_s: float) -> None:
        self._silent_ns = round(silent_s * 1e9)
        self._heard_ns = dict.fromkeys(sensors, 0)
        self._never = set(sensors)
        self._silent: set[str] = set()
        self.losses = dict.fromkeys(sensors, 0)

    def begin(self, now_ns: int) -> None:
        """From now on somebody listens."""
        self._heard_ns = dict.fromkeys(self._heard_ns, now_ns)

    def heard(self, sensor: str, arrival_ns: int) -> None:
        """A message of it that can be used."""
        if sensor in self._silent:
            after_s = (arrival_ns - self._heard_ns[sensor]) * 1e-9
            self._silent.discard(sensor)
            _log.warning("sensor is back", extra=fields(sensor=sensor, after_s=round(after_s, 1)))
        self._never.discard(sensor)
        self._heard_ns[sensor] = max(arrival_ns, self._heard_ns[sensor])

    def look(self, now_ns: int) -> None:
        """Notes who has fallen silent."""
        for sensor, heard_ns in self._heard_ns.items():
            if now_ns - heard_ns > self._silent_ns and sensor not in self._silent:
                self._silent.add(sensor)
                self.losses[sensor] += 1
                event = "sensor not heard yet" if sensor in self._never else "sensor silent"
                _log.warning(event, extra=fields(sensor=sensor, silent_s=round((now_ns - heard_ns) * 1e-9, 1)))

    def status(self, now_ns: int) -> str:
        """`imu silent for 12 s`, for all that are; "" for none."""
        silent = [
            (sensor, (now_ns - self._heard_ns[sensor]) * 1e-9) for sensor in self._heard_ns if self.is_lost(sensor)
        ]
        return ", ".join(f"{sensor} silent for {seconds:.0f} s" for sensor, seconds in silent)

    def is_lost(self, sensor: str) -> bool:
        """It has been silent for too long, and still is."""
        return sensor in self._silent
