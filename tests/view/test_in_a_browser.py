"""Rerun's page in headless Chromium: what is to be seen is seen, by its colours, where it must be."""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.chromium import Chromium, ChromiumError, chromium
from splitslam.view.colours import colours_of
from tests import debian
from tests.conftest import ROOT
from tests.e2e.commands import BIN
from tests.view.made_run import write_run

SIZE = 1280, 800
SHOWN_S = 90.0


@pytest.fixture(scope="module")
def browser() -> Iterator[Chromium]:
    program, environment = debian.chromium()
    with chromium(program, SIZE, environment) as started:
        yield started


@contextmanager
def page_of(*arguments: str) -> Iterator[str]:
    """The address that `splitslam view --web` prints."""
    command = (str(BIN / "splitslam"), "view", *arguments, "--web")
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline().strip()
            assert line.startswith("http://127.0.0.1:"), line
            yield line
        finally:
            process.terminate()
            assert process.wait(60) == 0


def near(picture: NDArray[np.uint8], colour: tuple[int, int, int], off: float = 0.12) -> NDArray[np.bool_]:
    """Pixels (height, width) of this hue, however bright: the angle between the colours."""
    rgb, wanted = picture.astype(float), np.array(colour, float)
    length = np.linalg.norm(rgb, axis=2)
    cosine = rgb @ wanted / np.maximum(length, 1.0) / np.linalg.norm(wanted)
    return (length > 60.0) & (cosine > np.cos(off))


def world_of(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The upper part of the page: the map's view, without the bar above it."""
    return picture[int(0.06 * SIZE[1]) : int(0.62 * SIZE[1])]


def test_map_and_trajectory_of_a_finished_run_are_visible(browser: Chromium, tmp_path: Path) -> None:
    write_run(tmp_path)
    colours = colours_of(0)
    with page_of(str(tmp_path)) as url:
        browser.open(url)
        deadline_s, world = time.monotonic() + SHOWN_S, np.zeros((*SIZE[::-1], 3), np.uint8)
        while True:
            with suppress(ChromiumError):  # while it loads, a page may be none for a moment
                world = world_of(browser.picture())
            way, walls = near(world, colours.way), near(world, colours.map_high) | near(world, colours.map_low)
            if (way.sum() > 300 and walls.sum() > 3_000) or time.monotonic() > deadline_s:
                break
            time.sleep(0.5)
        if out := os.environ.get("SPLITSLAM_PICTURES"):
            browser.save(Path(out, "browser.png"))
    assert way.sum() > 300, "the corrected trajectory"
    assert walls.sum() > 3_000, "the map"
    rows, columns = np.nonzero(way)
    inside = np.nonzero(walls)
    for at, around in zip((rows, columns), inside, strict=True):  # a lap in a walled yard: the walls lie around it
        assert np.percentile(around, 1) < np.percentile(at, 5)
        assert np.percentile(at, 95) < np.percentile(around, 99)
