"""Targets that anybody who reaches the service can feed: codec payloads, Hello, robot files, the proxy's header."""

from __future__ import annotations

import numpy as np
from google.protobuf.message import DecodeError as WireError

from map_service.callers import DeniedError, forwarded_caller
from map_service.dense_receiver import DenseReceiver
from map_service.hello import RefusedError, read_hello, session_id_of
from splitslam import dense_cloud
from splitslam.codec import CODEC_VERSION, DecodeError
from splitslam.errors import InputError
from splitslam.motion_table import motion_table
from splitslam.robot import Robot, robot_from_yaml, robot_to_yaml
from splitslam.wire import dense_pb2 as dense_pb
from splitslam.wire import session_pb2 as pb
from tests.codec.mutations import KINDS, check, decode, payloads, sealed
from tests.codec.mutations import mutated as payload_mutated
from tests.dense.made import cloud
from tests.fuzz.mutate import Rng, mutated
from tests.fuzz.target import Target
from tests.map_service.harness import frame, hello, new_run

_BOMB = b"".join(b"%c: &%c [%s]\n" % (c, c, b",".join([b"*%c" % (c - 1)] * 9)) for c in range(98, 106))
_MERGED = b"".join(b"%c: &%c {<<: [%s]}\n" % (c, c, b",".join([b"*%c" % (c - 1)] * 9)) for c in range(98, 106))
YAMLS = [
    robot_to_yaml(Robot()).encode(),
    b"robot: {id: rover-7}\nlidar: {model: generic, rings: 32, crop_boxes_body: [[0, 0, 0, 1, 1, 1]]}\n"
    b"gnss: {topic: null}\nT_lidar_imu: [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]\n",
    b"lidar: {crop_boxes_body: *i}\na: &a [1,1,1,1,1,1,1,1,1]\n" + _BOMB,
    b"a: &a [1,1,1,1,1,1,1,1,1]\n" + _BOMB + b"lidar: {crop_boxes_body: *i, beam_elevations_deg: *i}\n",
    b"a: &a {k: 1}\n" + _MERGED,
    b"robot: " + b"[" * 5000,
    b"gravity_mps2: " + b"9" * 5000,
    b"? {a: [1e400, .nan, -.inf, 0x10, 1_0, 2020-01-01, !!python/name:os.system ]} : !!binary aGk=",
]


def codec() -> Target:
    whole = payloads()

    def make(rng: Rng) -> bytes:
        a, b = rng.integers(len(whole), size=2)
        kind = KINDS[rng.integers(len(KINDS))]
        return sealed(payload_mutated(whole[a], whole[b], kind, rng))

    def feed(data: bytes) -> None:
        made = decode(data)
        check(made, data)
        table = motion_table(made.motion.knots)
        assert np.isfinite(table.base).all()
        assert np.isfinite(table.slope).all()

    return Target("codec", make, feed, (DecodeError,))


def messages() -> Target:
    """StreamRequests, and what is read of a Hello before anything is opened for it."""
    robot = hello(new_run(), lockstep=False)
    robot.disable.extend(["gnss", "loops"])
    requests = [
        pb.StreamRequest(hello=hello(new_run())),
        pb.StreamRequest(hello=robot),
        pb.StreamRequest(frame=frame(7, fixes=[{"stamp_ns": 1, "latitude_deg": 48.0}])),
        pb.StreamRequest(report=pb.EdgeReport(dropped_by_reason={"full": 3}, spool_frames=1)),
        pb.StreamRequest(bye=pb.Bye(last_seq=7)),
    ]
    seeds = [request.SerializeToString() for request in requests]

    def feed(data: bytes) -> None:
        request = pb.StreamRequest.FromString(data)
        if request.HasField("hello"):
            session_id_of(request.hello)
            read_hello(request.hello, CODEC_VERSION)

    return Target("messages", lambda rng: mutated(seeds, rng), feed, (WireError, RefusedError))


class _Clouds:
    """Wants everything, and keeps nothing."""

    def wants(self, session_id: str, offer: dense_pb.CloudOffer) -> dense_pb.UploadResponse:
        return dense_pb.UploadResponse(verdict=dense_pb.CLOUD_VERDICT_WANTED)

    def put(self, session_id: str, offer: dense_pb.CloudOffer, cloud: bytes) -> dense_pb.CloudVerdict:
        head = dense_cloud.check(cloud)
        assert (head.seq, head.stamp_ns, len(cloud)) == (offer.seq, offer.stamp_ns, offer.size)
        return dense_pb.CLOUD_VERDICT_STORED


def uploads() -> Target:
    """UploadRequests one after the other on the stream of one robot."""
    whole = cloud(points=40)
    stamp_ns = dense_cloud.check(whole).stamp_ns
    half = len(whole) // 2
    requests = [
        dense_pb.UploadRequest(open=dense_pb.UploadOpen(robot_id="r", run_id=new_run())),
        *[dense_pb.UploadRequest(offer=dense_pb.CloudOffer(seq=1, stamp_ns=stamp_ns, size=len(whole)))] * 2,
        dense_pb.UploadRequest(chunk=dense_pb.CloudChunk(offset=0, data=whole[:half])),
        dense_pb.UploadRequest(chunk=dense_pb.CloudChunk(offset=half, data=whole[half:])),
        dense_pb.UploadRequest(chunk=dense_pb.CloudChunk(offset=0, data=whole)),
    ]
    seeds, receiver = [request.SerializeToString() for request in requests], DenseReceiver(_Clouds(), "r/1")

    def make(rng: Rng) -> bytes:
        return seeds[rng.integers(len(seeds))] if rng.random() < 0.7 else mutated(seeds, rng)

    def feed(data: bytes) -> None:
        answer = receiver.take(dense_pb.UploadRequest.FromString(data))
        assert answer.verdict != dense_pb.CLOUD_VERDICT_UNSPECIFIED
        assert len(answer.detail) < 200

    return Target("uploads", make, feed, (WireError,))


def robot_files() -> Target:
    def feed(data: bytes) -> None:
        robot = robot_from_yaml(data.decode(errors="replace"))
        assert robot_from_yaml(robot_to_yaml(robot)) == robot

    def make(rng: Rng) -> bytes:
        if rng.random() < 0.7:
            return mutated(YAMLS, rng)
        data = bytearray(YAMLS[rng.integers(2)])  # one that reads as before, with another number
        digits = [at for at, byte in enumerate(data) if chr(byte).isdigit()]
        data[digits[rng.integers(len(digits))]] = ord(str(rng.integers(10)))
        return bytes(data)

    return Target("robot files", make, feed, (InputError,))


def forwarded() -> Target:
    print_ = "ab" * 32
    texts = [
        f"Hash={print_};URI=spiffe://farm/site/north/robot/rover-1",
        f'By=spiffe://farm/envoy;Hash={print_};Subject="CN=\\"a\\",O=b";URI=spiffe://farm/operator/ann;DNS=x',
        "Hash=;" * 500,
        'Subject="' + "\\" * 1000,
    ]
    seeds = [text.encode() for text in texts]

    def feed(data: bytes) -> None:
        caller = forwarded_caller([data.decode("latin-1")])
        assert caller.identity is not None
        assert caller.identity.uri.encode() in data

    return Target("forwarded", lambda rng: mutated(seeds, rng), feed, (DeniedError,))
