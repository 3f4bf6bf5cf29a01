from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.edge_memory import verdict


def test_growth_is_told_once_all_is_settled_and_the_largest_is_that_of_the_last_minute():
    samples = [(10.0 * k, 100.0 + 10.0 * min(k, 12) + (0.2 / 6.0) * k) for k in range(61)]
    found = verdict(samples)
    assert found["growth_mb_a_minute"] == pytest.approx(0.2, abs=1e-6)
    assert found["rss_mb"] == pytest.approx(samples[-1][1])


def test_an_agent_is_looked_at_while_it_plays_more_than_the_recording_has(shared_data: Path, tmp_path: Path):
    part = ("--minutes", "0.2", "--begin", "1", "--end", "4")  # 12 s of these 4
    command = [sys.executable, "-m", "benchmarks.edge_memory", str(shared_data / "yard1" / "yard1.bag"), *part]
    subprocess.run([*command, "--out", str(tmp_path / "memory.json")], check=True, capture_output=True, timeout=300)
    samples = json.loads((tmp_path / "memory.json").read_text())["samples"]
    assert [t_s for t_s, _ in samples] == pytest.approx([5.0, 10.0], abs=0.3)
    assert all(50.0 < mb < 1000.0 for _, mb in samples)
