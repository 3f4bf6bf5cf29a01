"""The command `splitslam`. What a command needs is imported inside it: `--help` must not wait for numba or gtsam."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from splitslam.errors import InputError
from splitslam.run.processes import RunFailedError
from splitslam.security.command import certs

_UsageError: Any = typer.BadParameter.__base__  # of the click that typer brings along or, in older ones, depends on
_INTERRUPTED = 130

app = typer.Typer(
    name="splitslam",
    help="LiDAR SLAM split between a robot and a map service.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)


bench = typer.Typer(help="The paper's experiments on recordings of your own.", no_args_is_help=True)
app.add_typer(bench, name="bench")
app.add_typer(certs, name="certs")


@app.callback(invoke_without_command=True)
def _options(version: Annotated[bool, typer.Option("--version", help="Print the version and exit.")] = False) -> None:
    if version:
        from importlib.metadata import version as installed

        print(installed("splitslam"))
        raise typer.Exit


@app.command("eval")
def evaluate(
    estimate: Annotated[Path, typer.Argument(metavar="ESTIMATE.tum", help="The trajectory to score.")],
    truth: Annotated[Path, typer.Option(metavar="TRUTH.tum", help="The true trajectory.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object.")] = False,
) -> None:
    """Score a trajectory against the truth: ATE, RPE over 1 s and 10 m, end error."""
    from splitslam import evaluate as scoring

    result = scoring.evaluate_files(estimate, truth)
    print(scoring.as_json(result)) if as_json else scoring.show(result)


@app.command("run")
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
        disable=_listed(disable),
        max_kbps=max_kbps,
        truth=truth,
        picture=picture,
    )
    with Progress() as progress:
        report = run_recording(options, progress)
    _show_run(report, out, as_json)


@app.command("check")
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


@app.command("diagnose")
def diagnose(
    edge: Annotated[
        list[str] | None,
        typer.Option(metavar="DIR|URL", help="State directory of an agent here, or http://HOST:PORT of one elsewhere."),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The agent's configuration; default: what it was started with.")
    ] = None,
    map_config: Annotated[
        Path | None, typer.Option("--map", metavar="FILE", help="Configuration of a map service of this machine.")
    ] = None,
    log: Annotated[list[Path] | None, typer.Option(metavar="FILE", help="A log besides systemd's journal.")] = None,
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="The bundle; default: by host and time.")] = None,
    raw: Annotated[bool, typer.Option("--raw/--no-raw", help="With the last seconds of raw scans.")] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print summary.json.")] = False,
) -> None:
    """Write one bundle for whoever is to help: self-checks, raw scans, logs, configuration without secrets."""
    import json

    from splitslam.run.options import check_installed

    check_installed(("server",) if map_config and not edge else ("edge",))
    from splitslam.diagnose.command import DiagnoseOptions
    from splitslam.diagnose.command import diagnose as look
    from splitslam.diagnose.show import show

    asked = DiagnoseOptions(tuple(edge or ()), config, map_config, tuple(log or ()), out, raw)
    diagnosis = look(asked)
    print(json.dumps(diagnosis.as_dict())) if as_json else show(diagnosis)


@bench.command("partition")
def bench_partition(
    recordings: Annotated[list[Path], typer.Argument(metavar="RECORDING...", help="Bags, robot file beside each.")],
    robot: Annotated[Path | None, typer.Option(metavar="FILE", help="Robot file of a single recording.")] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where partition.json and .png go.")] = Path("out/partition"),
    max_scans: Annotated[int | None, typer.Option(metavar="N", help="Read only so many scans of each.")] = None,
    disable: Annotated[str, typer.Option(metavar="LIST", help="Comma-separated, of loops, gnss, imu, wheels.")] = "",
    max_kbps: Annotated[float | None, typer.Option(metavar="N", help="Upper bound of our uplink, kbit/s.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print partition.json.")] = False,
) -> None:
    """What each cut through LIO-SAM sends, and how long a scan takes: Tables III and IV, Figure 12."""
    import json

    from splitslam.bench.options import PartitionOptions
    from splitslam.run.options import check_installed
    from splitslam.run.progress import Progress

    options = PartitionOptions(tuple(recordings), out, robot, max_scans, _listed(disable), max_kbps)
    check_installed(("viz", "edge", "server"))
    from splitslam.bench.partition import bench_partition as measure
    from splitslam.bench.partition_show import show

    with Progress() as progress:
        found, result = measure(options, progress)
    if as_json:
        print(json.dumps(result, allow_nan=False))
        return
    show(found, laz_missing=result["laz"] is None)
    print(f"{out / 'partition.json'}\n{out / 'partition.png'}")


@bench.command("delay")
def bench_delay(
    recording: Annotated[Path, typer.Argument(metavar="RECORDING", help="A bag, robot file beside it.")],
    delays: Annotated[str, typer.Option(metavar="LIST", help="Milliseconds, separated by commas.")] = "0,100,300,1000",
    truth: Annotated[Path | None, typer.Option(metavar="TRUTH.tum", help="Default: the .tum beside it.")] = None,
    robot: Annotated[Path | None, typer.Option(metavar="FILE", help="Robot file.")] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where delay.json and .png go.")] = Path("out/delay"),
    max_scans: Annotated[int | None, typer.Option(metavar="N", help="Read only so many scans.")] = None,
    disable: Annotated[str, typer.Option(metavar="LIST", help="Comma-separated, of gnss, imu, wheels.")] = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print delay.json.")] = False,
) -> None:
    """How good the robot's pose is when the map service's answers are late."""
    import json

    from splitslam.bench.options import DelayOptions, milliseconds
    from splitslam.run.options import check_installed
    from splitslam.run.progress import Progress

    options = DelayOptions(recording, out, milliseconds(delays), robot, truth, max_scans, _listed(disable))
    check_installed(("viz", "edge", "server"))
    from splitslam.bench.delay import bench_delay as measure
    from splitslam.bench.delay_show import show

    with Progress() as progress:
        result, made = measure(options, progress)
    if as_json:
        print(json.dumps(made, allow_nan=False))
        return
    show(result)
    print(f"{out / 'delay.json'}\n{out / 'delay.png'}")


@bench.command("load")
def bench_load(
    recording: Annotated[
        Path | None, typer.Argument(metavar="[RECORDING]", help="A bag; without, a drive that is made.")
    ] = None,
    robots: Annotated[int | None, typer.Option(metavar="N", help="So many; without, the most are searched.")] = None,
    seconds: Annotated[float, typer.Option(metavar="S", help="How long each try plays.")] = 30.0,
    start: Annotated[
        str, typer.Option(metavar="HOW", help="together: all in step, the worst case; or spread over a second.")
    ] = "together",
    workers: Annotated[int, typer.Option(metavar="N", help="Of the service; 0: its default.")] = 0,
    robot: Annotated[Path | None, typer.Option(metavar="FILE", help="Robot file of the recording.")] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where load.json goes.")] = Path("out/load"),
    as_json: Annotated[bool, typer.Option("--json", help="Print load.json.")] = False,
) -> None:
    """How many robots one map service answers in time on this machine, and what one costs."""
    import json

    from splitslam.run.options import check_installed

    check_installed(("edge", "server") if recording else ("sim", "edge", "server"))
    from splitslam.bench.load.command import LoadOptions
    from splitslam.bench.load.command import bench_load as measure
    from splitslam.bench.load.show import show
    from splitslam.run.progress import Progress
    from splitslam.stack.process import StackError

    options = LoadOptions(out, recording, robot, robots, seconds, start, workers)  # type: ignore[arg-type]
    try:
        with Progress() as progress:
            result = measure(options, progress)
    except StackError as error:
        raise RunFailedError(str(error)) from None
    print(json.dumps(result)) if as_json else show(result)
    if robots is not None and not result["largest"]:
        raise typer.Exit(1)


@app.command("demo")
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


@app.command("top")
def top(
    endpoints: Annotated[
        list[str] | None, typer.Argument(metavar="HOST:PORT", help="/metrics of agents and services, or URLs.")
    ] = None,
    every: Annotated[float, typer.Option(metavar="S", help="Seconds between two readings.")] = 2.0,
    once: Annotated[bool, typer.Option("--once", help="Print and exit; 1 when an endpoint gives no answer.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="The same as one JSON list.")] = False,
) -> None:
    """Edge agents and map services live: state, times, bytes, losses. Without endpoints: those of this machine."""
    from splitslam.top.command import run_top

    if not run_top(endpoints or (), every, once, as_json):
        raise typer.Exit(1)


@app.command("sim")
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


def _listed(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


def _show_run(report: dict[str, Any], out: Path, as_json: bool) -> None:
    import json

    from splitslam.report.summary import show

    print(json.dumps(report)) if as_json else show(report, out)


def main() -> None:
    """Entry point: exit code 2 and one line on stderr for whatever the user can mend."""
    try:
        exit_code = typer.main.get_command(app)(prog_name="splitslam", standalone_mode=False)
        if exit_code == _INTERRUPTED:  # some versions of typer catch Ctrl-C themselves
            raise KeyboardInterrupt
        sys.exit(exit_code)
    except (InputError, RunFailedError) as error:
        _fail(str(error), error.exit_code)
    except _UsageError as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "splitslam"
        _fail(f"{command}: {error.format_message().rstrip('.')} (see `{command} --help`)", 2)
    except OSError as error:  # a full disk, a folder that went away
        _fail(f"{error.filename or 'splitslam'}: {error.strerror or error}", 1)
    except (KeyboardInterrupt, typer.Abort):
        _fail("interrupted", _INTERRUPTED)


def _fail(line: str, exit_code: int) -> None:
    print(line, file=sys.stderr)
    sys.exit(exit_code)


if __name__ == "__main__":
    main()
