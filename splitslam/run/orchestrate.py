"""One run from the recording to the finished results."""

from __future__ import annotations

import contextlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edge_agent.config import AgentConfig
from splitslam import config
from splitslam.evaluate import as_dict, evaluate, inside
from splitslam.report.numbers import assemble
from splitslam.run.agent import Watcher, run_agent
from splitslam.run.configs import configs
from splitslam.run.options import RunOptions, check_installed
from splitslam.run.processes import Programs, RunFailedError, interruptible
from splitslam.run.progress import Progress
from splitslam.run.service import embedded_service
from splitslam.run.staging import Staging, staging
from splitslam.run.tables import write_keyframes, write_scans
from splitslam.tum import Trajectory, read_tum, write_tum

_FROM_AGENT = ("online.tum", "online_covariance.csv", "odom.tum", "imu.tum")
PROGRAMS = Programs()


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """A finished run: report.json, and what only report.html shows.

    edge: the agent's series by scan. trajectory, online, truth: T_map_lidar (truth in its own frame, or None).
    keyframes_map: (K, 3) positions, m. loops: which of them closures join. ply: the map.
    """

    title: str
    report: dict[str, Any]
    edge: dict[str, Any]
    trajectory: Trajectory
    online: Trajectory
    truth: Trajectory | None
    keyframes_map: list[tuple[float, float, float]]
    loops: list[tuple[int, int]]
    ply: Path


def run_recording(options: RunOptions, progress: Progress, programs: Programs = PROGRAMS) -> dict[str, Any]:
    """Run `options.recording` and write all results into `options.out`; returns report.json.

    Raises InputError for what can be seen before the start, RunFailedError for a program that did not finish (with
    its exit code: 2 for bad input). Then, and on Ctrl-C, nothing has been written and both programs have ended.
    """
    check_installed(("viz", "edge") if options.server else ("viz", "edge", "server"))
    if options.view:
        check_installed(("view",))
    _check_robot(options.robot)
    truth = None if options.truth is None else read_tum(options.truth)
    with interruptible(), staging(options.out) as stage:
        agent_config, service_config = configs(options, stage.work)
        with contextlib.ExitStack() as services:
            alive = _nothing
            if options.server is None:
                progress.stage("starting the map service")
                path = _written(stage.work / "map.yaml", service_config)
                service = services.enter_context(embedded_service(programs.map_service, path))
                agent_config = agent_config.model_copy(update={"server": service.address})
                alive = service.check
            progress.stage("starting the edge agent")
            watcher = Watcher(progress.expected, progress.scan, progress.note, alive, progress.dense)
            with _recording(options, stage, agent_config, progress):
                run_agent(programs.edge_agent, _written(stage.work / "edge.yaml", agent_config), watcher)
            progress.stage("fetching trajectory and map")
            run = _fetch(options, stage, agent_config, truth, progress)
        progress.stage("writing the report")
        _write_reports(run, stage.results)
        if options.picture is not None:
            from splitslam.report.picture import write_picture

            write_picture(run, options.picture)
        stage.publish()
    return run.report


def _nothing() -> None:
    """A service that somebody else runs is not watched: the agent comes back to it by itself."""


def _check_robot(path: Path) -> None:
    from splitslam.robot import load_robot

    load_robot(path)


def _recording(
    options: RunOptions, stage: Staging, agent_config: AgentConfig, progress: Progress
) -> contextlib.AbstractContextManager[None]:
    """While it lasts, what a viewer would see is recorded, if that was asked for."""
    if not options.view:
        return contextlib.nullcontext()
    from splitslam.robot import load_robot
    from splitslam.view.recorder import recorded

    robot_id = load_robot(options.robot).robot.id
    return recorded(agent_config.server, agent_config.tls, robot_id, stage.results, progress.note)


def _written(path: Path, model: Any) -> Path:
    path.write_text(config.dump(model), encoding="utf-8")
    return path


def _fetch(
    options: RunOptions, stage: Staging, agent_config: AgentConfig, truth: Trajectory | None, progress: Progress
) -> Run:
    from splitslam.ply import write_ply
    from splitslam.run.session_client import session_client

    agent = stage.work / "agent"
    try:
        edge = json.loads((agent / "edge.json").read_text())
    except OSError:
        raise RunFailedError("edge-agent was stopped before the end of the recording") from None
    for name in _FROM_AGENT:
        (agent / name).replace(stage.results / name)
    with session_client(agent_config.server, edge["session_id"], agent_config.tls) as session:
        info, statistics = session.info()
        trajectory = session.trajectory()
        write_ply(stage.results / "map.ply", session.map_pieces())
    if not len(trajectory):
        raise RunFailedError("no scan was mapped")
    write_tum(stage.results / "trajectory.tum", trajectory)
    write_keyframes(stage.results / "keyframes.csv", session.keyframes)
    write_scans(stage.results / "scans.csv", edge)
    online = read_tum(stage.results / "online.tum")
    if truth is not None and not inside(trajectory, truth).any():
        progress.note(f"{options.truth}: no pose of the run lies in its time span: not scored")
        truth = None
    report = assemble(edge, info, statistics, trajectory)
    if truth is not None:
        report["evaluation"] = {
            name: as_dict(evaluate(estimate, truth))
            for name, estimate in (("trajectory", trajectory), ("online", online))
        }
    return Run(
        title=options.recording.name,
        report=report,
        edge=edge,
        trajectory=trajectory,
        online=online,
        truth=truth,
        keyframes_map=[row.pose[:3] for row in session.keyframes],
        loops=statistics.get("loop_keyframes", []),
        ply=stage.results / "map.ply",
    )


def _write_reports(run: Run, results: Path) -> None:
    from splitslam.report.page import write_page

    write_page(run, results / "report.html")
    text = json.dumps(run.report, indent=2, allow_nan=False)
    (results / "report.json").write_text(text + "\n", encoding="utf-8")
