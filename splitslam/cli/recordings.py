"""`splitslam sim`, `demo`, `check`, `run`, `eval`: a recording is made, held against its robot file, run, scored."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from splitslam.cli.words import listed
from splitslam.errors import InputError


def sim(
    drive: Annotated[str | None, typer.Argument(metavar="DRIVE", help="One of those that --list shows.")] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where bag, robot file and truth go.")] = Path("out/sim"),
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of noise and faults, not of the place.")] = 1,
    perturb: Annotated[
        str, typer.Option(metavar="LIST", help="none, middle or NAME[=STRENGTH],... (see --list).")
    ] = "none",
    seconds: Annotated[float | None, typer.Option(metavar="S", help="Only the first so many seconds.")] = None,
    wheels: Annotated[bool, typer.Option("--wheels", help="With wheel odometry on /wheel/odom.")] = False,
    no_gnss: Annotated[bool, typer.Option("--no-gnss", help="Without a GNSS receiver.")] = False,
    list_all: Annotated[bool, typer.Option("--list", help="Print drives and perturbations.")] = False,
) -> None:
    """Record a drive in a made world, with its exact truth and, if wanted, faults of its sensors."""
    from splitslam.run.options import check_installed

    check_installed(("sim",))
    from splitslam.sim import command

    if list_all:
        print(command.listing())
        return
    if drive is None:
        raise InputError("splitslam sim: expected a drive (see `splitslam sim --list`)")
    asked = {"seed": seed, "perturb": perturb, "seconds": seconds, "gnss": not no_gnss, "wheels": wheels}
    spec = command.drive_spec(drive, **asked)
    from splitslam.run.progress import Progress

    with Progress() as progress:
        progress.stage(f"making {drive}")
        made = command.make(spec, out, progress.made)
    for path in (made.bag_path, made.robot_path, made.truth_path, made.imu_truth_path):
        print(path)


def demo(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the results go.")] = Path("out/demo"),
    seconds: Annotated[float | None, typer.Option(metavar="S", help="Length of the drive.")] = None,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of the sensors' noise.")] = 1,
    picture: Annotated[Path | None, typer.Option(metavar="FILE", help="Also draw the run as a PNG.")] = None,
    chaos: Annotated[
        bool, typer.Option("--chaos", help="Four robots, three replicas, and plugs that are pulled.")
    ] = False,
    script: Annotated[
        str | None, typer.Option(metavar="FILE", help="With --chaos: what is pulled when; `default`; without, by keys.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print report.json (chaos.json).")] = False,
) -> None:
    """Make a short drive in a made world, run it through both programs, score it."""
    if chaos:
        if picture is not None:
            raise InputError("--picture: expected without --chaos")
        from splitslam.chaos.command import run_chaos

        run_chaos(out, seconds=seconds, seed=seed, script=script, as_json=as_json)
        return
    if script is not None:
        raise InputError("--script: expected with --chaos")
    from splitslam.demo import demo as run_demo
    from splitslam.run.progress import Progress

    with Progress() as progress:
        report = run_demo(out, progress, seconds=seconds, seed=seed, picture=picture)
    _show_run(report, out, as_json)


def check(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="ROS 1 bag, ROS 2 bag or mcap.")],
    robot: Annotated[Path, typer.Option(metavar="FILE", help="Robot file: the sensors, YAML.")],
    seconds: Annotated[float, typer.Option(metavar="S", help="How much of the recording, from its start.")] = 60.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Hold a recording against its robot file. Exit code 1 when something is to be mended, 2 for bad input."""
    import json

    from splitslam.run.options import check_installed
    from splitslam.run.progress import Progress

    if not seconds > 0:
        raise InputError(f"--seconds: expected more than 0, found {seconds:g}")
    check_installed(("edge", "server"))
    from splitslam.check import show
    from splitslam.check.offline import check_recording

    with Progress() as progress:
        progress.stage("checking")
        report = check_recording(recording, robot, seconds, progress.made)
    result = show.as_dict(report)
    print(json.dumps(result, allow_nan=False)) if as_json else show.show(report)
    if not result["ok"]:
        raise typer.Exit(1)


def run(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="ROS 1 bag, ROS 2 bag or mcap.")],
    robot: Annotated[Path, typer.Option(metavar="FILE", help="Robot file: the sensors, YAML.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the results go.")],
    config: Annotated[Path | None, typer.Option(metavar="FILE", help="YAML, sections `edge` and `map`.")] = None,
    server: Annotated[
        str | None, typer.Option(metavar="HOST:PORT", help="A running map service; without, an embedded one.")
    ] = None,
    realtime: Annotated[bool, typer.Option("--realtime", help="Pace by the recording's clock.")] = False,
    max_scans: Annotated[int | None, typer.Option(metavar="N", help="Read only so many scans.")] = None,
    deskew: Annotated[
        str | None, typer.Option(metavar="BACK_END", help="auto, reference, cpu, fpga, cosim, off or rotation.")
    ] = None,
    disable: Annotated[str, typer.Option(metavar="LIST", help="Comma-separated, of loops, gnss, imu, wheels.")] = "",
    max_kbps: Annotated[float | None, typer.Option(metavar="N", help="Upper bound of the uplink, kbit/s.")] = None,
    truth: Annotated[
        Path | None, typer.Option(metavar="TRUTH.tum", help="The true trajectory, scored and drawn in the report.")
    ] = None,
    picture: Annotated[Path | None, typer.Option(metavar="FILE", help="Also draw the run as a PNG.")] = None,
    view: Annotated[bool, typer.Option("--view", help="Also record what `splitslam view` shows: view.rrd.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print report.json.")] = False,
) -> None:
    """Run a recording through an edge agent and a map service: trajectory, map and report."""
    from splitslam.run.options import RunOptions
    from splitslam.run.orchestrate import run_recording
    from splitslam.run.progress import Progress

    options = RunOptions(
        recording=recording,
        robot=robot,
        out=out,
        config=config,
        server=server,
        realtime=realtime,
        max_scans=max_scans,
        deskew=deskew,
        disable=listed(disable),
        max_kbps=max_kbps,
        truth=truth,
        picture=picture,
        view=view,
    )
    with Progress() as progress:
        report = run_recording(options, progress)
    _show_run(report, out, as_json)


def evaluate(
    estimate: Annotated[Path, typer.Argument(metavar="ESTIMATE.tum", help="The trajectory to score.")],
    truth: Annotated[Path, typer.Option(metavar="TRUTH.tum", help="The true trajectory.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Score a trajectory against the truth: ATE, RPE over 1 s and 10 m, end error."""
    from splitslam import evaluate as scoring

    result = scoring.evaluate_files(estimate, truth)
    print(scoring.as_json(result)) if as_json else scoring.show(result)


def _show_run(report: dict[str, Any], out: Path, as_json: bool) -> None:
    import json

    from splitslam.report.summary import show

    print(json.dumps(report)) if as_json else show(report, out)
