"""Drift of the robot's pose while the network is away: `python -m benchmarks.outage --help`.

By the clock: both programs, a relay between them that is cut. In one process: answers are withheld by the recording's
clock, which needs no minute a minute and is the same each time.
"""

from __future__ import annotations

import json
import sys
import tempfile
import threading
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

if __package__ in (None, ""):  # run as a file
    sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.command import run
from edge_agent.odometry.settings import OdometrySettings
from splitslam.bench.drift import drift
from splitslam.bench.in_one_process import Network, run_both
from splitslam.evaluate import evaluate
from splitslam.run.configs import configs
from splitslam.run.options import RunOptions
from splitslam.run.orchestrate import PROGRAMS, run_recording
from splitslam.run.processes import interruptible
from splitslam.run.progress import Progress
from splitslam.run.service import embedded_service
from splitslam.tum import read_tum
from tests.edge_agent.relay import CountingRelay

app = typer.Typer(add_completion=False)
SCAN_HZ = 10


@dataclass(frozen=True, slots=True)
class Cut:
    """When the network is away, seconds after the first scan."""

    begin_s: float
    end_s: float


class _Scissors(Progress):
    """Cuts the network when the agent's scans have come so far, and joins it by the clock: then nothing is answered."""

    def __init__(self, relay: CountingRelay, cut: Cut) -> None:
        super().__init__()
        self._relay, self._cut = relay, cut
        self._join = threading.Timer(cut.end_s - cut.begin_s, self._joined)

    def scan(self, read: int, mapped: int) -> None:
        if read / SCAN_HZ >= self._cut.begin_s and self._join.ident is None:
            self._relay.away = True
            self._relay.cut()
            self._join.start()

    def _joined(self) -> None:
        self._relay.away = False


def by_the_clock(recording: Path, truth: Path, cut: Cut, max_scans: int | None = None) -> dict[str, Any]:
    """One `splitslam run --realtime` through the relay."""
    with tempfile.TemporaryDirectory(prefix="splitslam-outage-") as folder, interruptible():
        work, robot = Path(folder), recording.with_suffix(".yaml")
        options = RunOptions(recording, robot, work / "out", realtime=True, max_scans=max_scans)
        service_file = work / "map.yaml"
        service_file.write_text(_yaml(configs(options, work)[1]))
        with embedded_service(PROGRAMS.map_service, service_file) as service:
            host, port = service.address.rsplit(":", 1)
            relay = CountingRelay((host, int(port)))
            through = RunOptions(recording, robot, work / "out", None, relay.address, True, max_scans)
            report = run_recording(through, _Scissors(relay, cut))
            relay.close()
        odom, final = read_tum(work / "out/odom.tum"), read_tum(work / "out/trajectory.tum")
    outages, scans = report["outages"], report["scans"]
    return {
        **_drift(odom, truth, cut, int(odom.stamps_ns[0])),
        "ate_m": evaluate(final, read_tum(truth)).ate_m,
        "lost": scans["read"] - len(final),
        "caught_up_s": outages["seconds"] - (cut.end_s - cut.begin_s),
        "outages": outages,
        "edge_ms": report["edge_ms"]["total"]["mean"],
        "odom_max_m": report["jumps"]["odom_max_m"],
    }


def in_one_process(
    recording: Path,
    truth: Path,
    cut: Cut | None,
    odometry: bool = True,
    disable: tuple[str, ...] = (),
    max_scans: int | None = None,
    score: Cut | None = None,
) -> dict[str, Any]:
    """The same without programs. cut None: undisturbed. odometry False: the Imu node alone. score: instead of `cut`."""
    out = run_both(
        recording,
        recording.with_suffix(".yaml"),
        network=Network(silent_s=None if cut is None else (cut.begin_s, cut.end_s)),
        disable=disable,
        odometry=OdometrySettings(enabled=odometry),
        max_scans=max_scans,
    )
    part = score or cut
    assert part is not None
    return {
        **_drift(out.scans_odom.trajectory(), truth, part, out.start_ns),
        "ate_m": evaluate(out.final(), read_tum(truth)).ate_m,
        "outages": {**asdict(out.outages.report()), "odometry_ms": out.metrics.odometry.summary_ms()},
        "odom_max_m": out.node.jumps["odom_max_m"],
    }


def _yaml(model: Any) -> str:
    from splitslam import config

    return config.dump(model)


def _drift(odom: Any, truth: Path, cut: Cut, start_ns: int) -> dict[str, float]:
    found = drift(odom, read_tum(truth), start_ns + int(cut.begin_s * 1e9), start_ns + int(cut.end_s * 1e9))
    return {"way_m": found.way_m, "drift_m": found.translation_m, "drift_rad": found.rotation_rad, "share": found.share}


@app.command()
def main(
    recording: Annotated[Path, typer.Argument(help="A bag, its robot file beside it.")],
    begin: Annotated[float, typer.Option(help="When the network goes, s after the first scan.")] = 8.0,
    end: Annotated[float, typer.Option(help="When it is back.")] = 68.0,
    truth: Annotated[Path | None, typer.Option(help="TUM; default: beside the recording.")] = None,
    programs: Annotated[bool, typer.Option("--programs", help="Both programs, by the clock.")] = False,
    disable: Annotated[str, typer.Option(help="Comma-separated, of gnss, imu, wheels.")] = "",
    max_scans: Annotated[int | None, typer.Option(help="Read only so many scans.")] = None,
) -> None:
    """One JSON line each: undisturbed, the outage, and (in one process) the outage with the Imu node alone."""
    truth, cut = truth or recording.with_suffix(".tum"), Cut(begin, end)
    rows: dict[str, dict[str, Any]] = {}
    if programs:
        rows["outage"] = by_the_clock(recording, truth, cut, max_scans)
    else:
        off = tuple(part for part in disable.split(",") if part)
        rows["undisturbed"] = in_one_process(recording, truth, None, True, off, max_scans, score=cut)
        rows["outage"] = in_one_process(recording, truth, cut, True, off, max_scans)
        rows["outage, Imu node alone"] = in_one_process(recording, truth, cut, False, off, max_scans)
    for name, row in rows.items():
        print(json.dumps({"run": name, **row}))


if __name__ == "__main__":
    run(app)
