"""Which program this is: one series that is always 1, to join with and to count versions by."""

from __future__ import annotations

from prometheus_client import CollectorRegistry

from splitslam import __version__
from splitslam.codec import CODEC_VERSION
from splitslam.metrics.definition import Label, gauge
from splitslam.metrics.family import Family

BUILD_INFO = gauge(
    "splitslam_build_info",
    "1; the labels say which build this is, and the newest codec it encodes or decodes",
    "More than one version for longer than a roll-out takes.",
    Label("version", bound="one value"),
    Label("codec_version", bound="one value"),
)


def show_build(registry: CollectorRegistry) -> None:
    Family(BUILD_INFO, registry, version=[__version__], codec_version=[str(CODEC_VERSION)]).set(
        1, __version__, str(CODEC_VERSION)
    )
