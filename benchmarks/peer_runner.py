"""One peer on one dump: `peer_runner.py PEER DUMP POSES.npz`. Runs in .venv-bench, without our packages.

Each peer has its authors' defaults; it is told what the robot file says: ranges, rings, IMU noise, T_lidar_imu. Poses
go out as T_world_lidar with the stamp of the scan they came with. What moment they are really of differs from peer to
peer (start, middle or end of the scan, or of the one before): whoever scores them searches that constant offset.
"""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false
from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("t", "<u4"), ("row", "<u2")])


class Peer(Protocol):
    """A system under comparison, fed in order of time: what it costs is `imu` and `scan`.

    covered: whether the IMU's first sample at or after a scan's end comes before the scan; otherwise after it.
    What `sample` and `cloud` do, its own types made of our arrays, is the reader's work and not the peer's.
    """

    covered: bool

    def sample(self, stamp_ns: int, gyro_radps: Array, accel_mps2: Array) -> Any:
        """One IMU sample, frame `imu`, as the peer takes it."""
        ...

    def cloud(self, stamp_ns: int, end_ns: int, points: NDArray) -> Any:
        """One scan (POINT) as the peer takes it."""
        ...

    def imu(self, sample: Any) -> None:
        """The peer's work for a sample."""
        ...

    def scan(self, cloud: Any) -> Any:
        """The peer's work for a scan -> what `poses` is made of."""
        ...

    def poses(self, found: Any) -> list[tuple[int, Array]]:
        """New poses (stamp_ns, T_world_lidar (4, 4)); not the peer's work either."""
        ...


class KissIcp:
    """KISS-ICP's own Python pipeline, deskewing by constant velocity. No IMU."""

    covered = False

    def __init__(self, sensors: dict[str, Any]) -> None:
        from kiss_icp.config import load_config
        from kiss_icp.kiss_icp import KissICP

        config = load_config(None)
        config.data.min_range, config.data.max_range = sensors["lidar"]["min_range_m"], sensors["lidar"]["max_range_m"]
        config.mapping.voxel_size = config.data.max_range / 100.0  # its own rule
        config.registration.max_num_threads = 1
        self._odometry = KissICP(config)

    def sample(self, stamp_ns: int, gyro_radps: Array, accel_mps2: Array) -> None:
        """Not used."""

    def cloud(self, stamp_ns: int, end_ns: int, points: NDArray) -> tuple[int, Array, Array]:
        """Times go in as they are: it takes the fraction of the scan itself."""
        return stamp_ns, _xyz(points), points["t"] * 1e-9

    def imu(self, sample: None) -> None:
        """Not used."""

    def scan(self, cloud: tuple[int, Array, Array]) -> tuple[int, Array]:
        """Deskew, registration, map."""
        stamp_ns, points, times_s = cloud
        self._odometry.register_frame(points, times_s)
        return stamp_ns, self._odometry.last_pose

    def poses(self, found: tuple[int, Array]) -> list[tuple[int, Array]]:
        """The scan's."""
        stamp_ns, pose = found
        return [(stamp_ns, pose.copy())]


class RkoLio:
    """rko_lio, base frame = lidar. Its loader gives the IMU samples before the scan's end, and then the scan."""

    covered = False

    def __init__(self, sensors: dict[str, Any]) -> None:
        from rko_lio.config import LIOConfig
        from rko_lio.lio import LIO
        from rko_lio.rko_lio_pybind import InputError

        self._refused = InputError
        lidar = sensors["lidar"]
        config = LIOConfig(min_range=lidar["min_range_m"], max_range=lidar["max_range_m"], max_num_threads=1)
        self._lio, self._T_lidar_imu = LIO(config), np.array(sensors["T_lidar_imu"])

    def sample(self, stamp_ns: int, gyro_radps: Array, accel_mps2: Array) -> tuple[Array, Array, int]:
        """Specific force and rate, frame `imu`."""
        return accel_mps2, gyro_radps, stamp_ns

    def cloud(self, stamp_ns: int, end_ns: int, points: NDArray) -> tuple[Any, ...]:
        """Absolute times."""
        return _xyz(points), stamp_ns + points["t"].astype(np.int64), None, stamp_ns, end_ns

    def imu(self, sample: tuple[Array, Array, int]) -> None:
        """Integrated."""
        self._lio.add_imu_measurement(*sample, extrinsic_imu2base=self._T_lidar_imu)

    def scan(self, cloud: tuple[Any, ...]) -> tuple[int, Array] | None:
        """None for a scan that it refuses."""
        try:
            self._lio.register_scan(*cloud)
        except self._refused:
            return None
        return cloud[3], self._lio.pose()

    def poses(self, found: tuple[int, Array] | None) -> list[tuple[int, Array]]:
        """The scan's, if it has one."""
        return [] if found is None else [(found[0], found[1].copy())]


class Evalio:
    """A pipeline of evalio: LioSAM or DLIO, the authors' C++ without ROS. Poses come in frame `imu`.

    The whole default dictionary is set before `initialize`. Scans are rings x columns, row by row; every cell has a
    plausible time, the empty ones too, because LIO-SAM takes the scan's end from the last one.
    """

    covered = True

    def __init__(self, name: str, sensors: dict[str, Any]) -> None:
        from evalio import types
        from evalio._cpp import helpers, pipelines

        self._types, self._helpers = types, helpers
        lidar, imu = sensors["lidar"], sensors["imu"]
        self._rings, self._columns = lidar["rings"], lidar["columns"]
        self._T_imu_lidar = np.linalg.inv(np.array(sensors["T_lidar_imu"]))
        self._pipeline = getattr(pipelines, name)()
        parameters = self._pipeline.default_params()
        parameters.update({key: value for key, value in EVALIO_SETTINGS.items() if key in parameters})
        unknown = self._pipeline.set_params(parameters)
        assert not unknown, unknown
        self._pipeline.set_imu_params(
            types.ImuParams(
                gyro=imu["gyro_noise_radps_rthz"],
                accel=imu["accel_noise_mps2_rthz"],
                gyro_bias=imu["gyro_walk_radps2_rthz"],
                accel_bias=imu["accel_walk_mps3_rthz"],
                gravity=np.array([0.0, 0.0, -sensors["gravity_mps2"]]),
                rate=imu["rate_hz"],
            )
        )
        self._pipeline.set_lidar_params(
            types.LidarParams(
                num_rows=self._rings,
                num_columns=self._columns,
                min_range=lidar["min_range_m"],
                max_range=lidar["max_range_m"],
                rate=lidar["rate_hz"],
            )
        )
        self._pipeline.set_imu_T_lidar(types.SE3.from_mat(self._T_imu_lidar))
        self._pipeline.initialize()
        kind = helpers.DataType
        kinds = {"f4": kind.FLOAT32, "u4": kind.UINT32, "u2": kind.UINT16}
        self._fields = [
            helpers.Field(name=name, datatype=kinds[field.str[1:]], offset=offset)
            for name, (field, offset, *_) in (POINT.fields or {}).items()
        ]

    def sample(self, stamp_ns: int, gyro_radps: Array, accel_mps2: Array) -> Any:
        """Specific force and rate, frame `imu`."""
        return self._types.ImuMeasurement(self._types.Stamp.from_nsec(stamp_ns), gyro_radps, accel_mps2)

    def cloud(self, stamp_ns: int, end_ns: int, points: NDArray) -> Any:
        """evalio's measurement, by its own conversion of a PointCloud2."""
        grid = in_grid(points, self._rings, self._columns, end_ns - stamp_ns)
        cloud = self._helpers.PointCloudMetadata(
            stamp=self._types.Stamp.from_nsec(stamp_ns),
            width=grid.shape[1],
            height=grid.shape[0],
            point_step=POINT.itemsize,
            row_step=POINT.itemsize * grid.shape[1],
            is_bigendian=0,
            is_dense=0,
        )
        measurement = self._helpers.pc2_to_evalio(cloud, self._fields, grid.tobytes())
        self._helpers.fill_col_row_major(measurement)
        return measurement

    def imu(self, sample: Any) -> None:
        """Integrated, and for LIO-SAM a step of its graph."""
        self._pipeline.add_imu(sample)

    def scan(self, cloud: Any) -> Any:
        """The poses that have become ready, evalio's."""
        self._pipeline.add_lidar(cloud)
        return self._pipeline.saved_estimates()

    def poses(self, found: Any) -> list[tuple[int, Array]]:
        """Frame `lidar`."""
        return [(stamp.to_nsec(), pose.to_mat() @ self._T_imu_lidar) for stamp, pose in found]


def in_grid(points: NDArray, rings: int, columns: int, duration_ns: int) -> NDArray:
    """(rings, C) POINT: each ring's points by their time, empty cells at 0 m with their column's time.

    C is at least `columns`, and such that a ring with more points than columns keeps them all.
    """
    fullest = int(np.bincount(points["row"], minlength=rings).max(initial=0))
    columns = max(columns, fullest)
    grid = np.zeros((rings, columns), POINT)
    grid["row"] = np.arange(rings)[:, None]
    grid["t"] = np.rint(np.arange(columns) * (duration_ns / (columns - 1)))
    for ring in range(rings):
        row = points[points["row"] == ring]
        row = row[np.argsort(row["t"], kind="stable")]
        wanted = np.rint(row["t"] * ((columns - 1) / duration_ns)).astype(np.int64)
        grid[ring, distinct(wanted, columns)] = row
    return grid


def distinct(wanted: NDArray[np.int64], columns: int) -> NDArray[np.int64]:
    """Ascending column numbers moved as little as needed to be distinct and in [0, columns)."""
    place = np.arange(len(wanted))
    pushed = np.maximum.accumulate(wanted - place) + place
    return np.minimum(pushed, columns - len(wanted) + place)


def _xyz(points: NDArray) -> Array:
    return np.stack([points[name] for name in "xyz"], axis=1).astype(np.float64)


# LIO-SAM maps every second scan by default, and repeats its last pose for the others.
EVALIO_SETTINGS = {"numberOfCores": 1, "mappingProcessInterval": 0.0}
PEERS = {
    "kiss_icp": KissIcp,
    "rko_lio": RkoLio,
    "lio_sam": lambda sensors: Evalio("LioSAM", sensors),
    "dlio": lambda sensors: Evalio("DLIO", sensors),
}


def steps(folder: Path, covered: bool) -> Iterator[tuple[NDArray, NDArray]]:
    """(new IMU samples, scan row): each scan after the samples before its end and, if `covered`, the next one."""
    scans, samples = np.load(folder / "scans.npy"), np.load(folder / "imu.npy")
    done = 0
    for scan in scans:
        until = max(done, int(np.searchsorted(samples["stamp_ns"], scan["end_ns"])) + covered)
        yield samples[done:until], scan
        done = until


def main() -> None:
    """Feeds the peer; writes stamps_ns (N,), T_world_lidar (N, 4, 4), and by scan (scans,) cpu_s and prepare_s.

    cpu_s: CPU time of the whole process in the peer's own calls; prepare_s: in making its input.
    """
    name, folder, out = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    sensors = json.loads((folder / "sensors.json").read_text())
    points = np.memmap(folder / "points.bin", POINT, "r")
    peer: Peer = PEERS[name](sensors)
    poses: list[tuple[int, Array]] = []
    times_s = []
    for samples, scan in steps(folder, peer.covered):
        given = np.array(points[scan["begin"] : scan["end"]])  # off the disk: in neither time
        begun_s = time.process_time()
        imu = [
            peer.sample(int(sample["stamp_ns"]), sample["gyro_radps"].copy(), sample["accel_mps2"].copy())
            for sample in samples
        ]
        cloud = peer.cloud(int(scan["stamp_ns"]), int(scan["end_ns"]), given)
        prepared_s = time.process_time()
        for sample in imu:
            peer.imu(sample)
        found = peer.scan(cloud)
        times_s.append((time.process_time() - prepared_s, prepared_s - begun_s))
        poses += peer.poses(found)
    cpu_s, prepare_s = np.array(times_s).reshape(-1, 2).T
    np.savez(
        out,
        stamps_ns=np.array([stamp for stamp, _ in poses], np.int64),
        T_world_lidar=np.array([T for _, T in poses]).reshape(-1, 4, 4),
        cpu_s=cpu_s,
        prepare_s=prepare_s,
    )


if __name__ == "__main__":
    main()
