"""`splitslam bench ...`: the experiments."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from splitslam.cli.words import listed
from splitslam.run.processes import RunFailedError

bench = typer.Typer(help="The paper's experiments on recordings of your own.", no_args_is_help=True)


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

    options = PartitionOptions(tuple(recordings), out, robot, max_scans, listed(disable), max_kbps)
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


@bench.command("edge")
def bench_edge(
    recordings: Annotated[
        list[Path] | None, typer.Argument(metavar="[RECORDING...]", help="Bags, robot file beside each; none: made.")
    ] = None,
    robot: Annotated[Path | None, typer.Option(metavar="FILE", help="Robot file of a single recording.")] = None,
    grids: Annotated[
        str, typer.Option(metavar="LIST", help="LiDARs of made drives, RINGSxCOLUMNS.")
    ] = "16x1800,32x1800,64x2048,128x2048",
    seconds: Annotated[float, typer.Option(metavar="S", help="Length of a made drive.")] = 8.0,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where edge.json, edge.png, made/ go.")] = Path("out/edge"),
    max_scans: Annotated[int | None, typer.Option(metavar="N", help="Read only so many scans of each.")] = None,
    fpga: Annotated[bool, typer.Option("--fpga/--no-fpga", help="With the simulated cores as well.")] = True,
    as_json: Annotated[bool, typer.Option("--json", help="Print edge.json.")] = False,
) -> None:
    """How long the edge takes for a scan, with and without FPGA: Tables V and VI, Figures 10 and 11."""
    import json

    from splitslam.run.options import check_installed
    from splitslam.run.progress import Progress

    check_installed(("viz", "edge", "server") if recordings else ("viz", "edge", "server", "sim"))
    from splitslam.bench.edge_made import grids as parsed
    from splitslam.bench.options import EdgeOptions

    options = EdgeOptions(tuple(recordings or ()), out, robot, parsed(grids), seconds, max_scans, fpga)
    from splitslam.bench.edge import bench_edge as measure
    from splitslam.bench.edge_show import show

    with Progress() as progress:
        found, result = measure(options, progress)
    if as_json:
        print(json.dumps(result, allow_nan=False))
        return
    show(found, result["with_fpga"])
    print(f"{out / 'edge.json'}\n{out / 'edge.png'}")


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

    options = DelayOptions(recording, out, milliseconds(delays), robot, truth, max_scans, listed(disable))
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
