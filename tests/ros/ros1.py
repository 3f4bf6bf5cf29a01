"""ROS 1 of Debian for a test: installed on the machine, or unpacked into this checkout's cache without root."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rosbags.rosbag1 import Reader, Writer

from splitslam.stack.process import free_port
from tests.debian import unpacked

PACKAGES = ("python3-roslaunch", "python3-rospy", "python3-rosbag")
PYTHON = "/usr/bin/python3"  # Debian's packages are for Debian's Python
_START_S = 60.0


@dataclass(frozen=True)
class Ros1:
    """A master that runs, alone on loopback. root: where its programs are. environment: of each of them.

    ours: environment of our own programs, which must not see Debian's Python packages before theirs.
    """

    root: Path
    uri: str
    environment: dict[str, str]
    ours: dict[str, str]

    @property
    def python_path(self) -> str:
        return str(self.root / "usr" / "lib" / "python3" / "dist-packages")

    def rosbag_play(self, bag: Path) -> list[str]:
        """At the recording's own pace, from when all topics have a listener."""
        program = str(self.root / "usr" / "bin" / "rosbag")
        return [PYTHON, program, "play", "--quiet", "--wait-for-subscribers", "--queue=1000", str(bag)]


def plain_copy(bag: Path, copy: Path, seconds: float) -> int:
    """The first seconds of a ROS 1 bag, not compressed: rosbag does not read every LZ4 frame. Returns the scans."""
    scans, first_ns = 0, None
    with Reader(bag) as reader, Writer(copy) as writer:
        out = {
            one.id: writer.add_connection(one.topic, one.msgtype, msgdef=one.msgdef.data, md5sum=one.digest)
            for one in reader.connections
        }
        for connection, arrival_ns, raw in reader.messages():
            first_ns = arrival_ns if first_ns is None else first_ns
            if arrival_ns - first_ns > seconds * 1e9:
                break
            writer.write(out[connection.id], arrival_ns, raw)
            scans += connection.msgtype.endswith("VelodyneScan")
    return scans


@contextmanager
def roscore(folder: Path) -> Iterator[Ros1]:
    """A roscore on a free port. folder: for its logs."""
    root = Path("/") if shutil.which("roscore") else unpacked(*PACKAGES, with_needs=True)
    port = free_port()
    uri = f"http://127.0.0.1:{port}"
    ours = os.environ | {"ROS_MASTER_URI": uri, "ROS_IP": "127.0.0.1", "ROS_HOME": str(folder / "ros")}
    ros = Ros1(root, uri, ours | _programs(root), ours)
    with (folder / "roscore.log").open("w") as log:
        command = [PYTHON, str(root / "usr" / "bin" / "roscore"), "-p", str(port)]
        process = subprocess.Popen(command, env=ros.environment, stdout=log, stderr=log, start_new_session=True)
        try:
            deadline_s = time.monotonic() + _START_S
            while not _answers(port):
                said = (folder / "roscore.log").read_text()
                assert process.poll() is None, f"roscore: exit code {process.returncode}: {said}"
                assert time.monotonic() < deadline_s, f"roscore does not answer: {said}"
                time.sleep(0.05)
            yield ros
        finally:
            process.terminate()  # it ends rosmaster and rosout itself
            process.wait(20)


def _programs(root: Path) -> dict[str, str]:
    """What its programs need to find each other when they are not where Debian puts them."""
    usr = root / "usr"
    libraries = usr / "lib" / f"{os.uname().machine}-linux-gnu"
    if root != Path("/"):
        (usr / ".catkin").touch()
        index = usr / "share" / "ament_index" / "resource_index" / "packages" / "rosbag_storage"
        plugins = usr / "lib" / "rosbag_storage"
        for made in (index.parent, plugins):
            made.mkdir(parents=True, exist_ok=True)
        index.touch()
        for plugin in (libraries / "ros").glob("librosbag*"):
            (plugins / plugin.name).unlink(missing_ok=True)
            (plugins / plugin.name).symlink_to(plugin)
    return {
        "PATH": f"{usr / 'bin'}:{os.environ['PATH']}",
        "PYTHONPATH": str(usr / "lib" / "python3" / "dist-packages"),
        "LD_LIBRARY_PATH": str(libraries),
        "ROS_PACKAGE_PATH": str(usr / "share"),
        "CMAKE_PREFIX_PATH": str(usr),
        "AMENT_PREFIX_PATH": str(usr),
    }


def _answers(port: int) -> bool:
    try:
        socket.create_connection(("127.0.0.1", port), 0.2).close()
    except OSError:
        return False
    return True
