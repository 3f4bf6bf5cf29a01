"""What happened to a session, as splitslam.v1.Event; session and number are the store's to give."""

from __future__ import annotations

from map_service.happenings import DatumFound, Happened, LoopAccepted, MapMove
from map_service.messages import transform_to_wire
from map_service.types import CorrectionRecord, State
from splitslam.wire import pose_pb2 as pb
from splitslam.wire import types_pb2 as types_pb


def happened_event(happened: Happened) -> pb.Event:
    """Of what the pipeline has noted."""
    event = pb.Event(seq=happened.seq, stamp_ns=happened.stamp_ns)
    match happened.what:
        case MapMove(version, first_seq, cause, translation_m, rotation_rad):
            event.map.CopyFrom(map_move(version, first_seq, int(cause), translation_m, rotation_rad))
        case LoopAccepted(older, newer, translation_m, rotation_rad):
            event.loop.CopyFrom(
                pb.LoopAccepted(
                    older_keyframe=older, newer_keyframe=newer, translation_m=translation_m, rotation_rad=rotation_rad
                )
            )
        case DatumFound(datum, (latitude_deg, longitude_deg, altitude_m), T_enu_map):
            event.gnss_datum.CopyFrom(
                pb.GnssDatumFound(
                    datum=datum,
                    latitude_deg=latitude_deg,
                    longitude_deg=longitude_deg,
                    altitude_m=altitude_m,
                    pose_enu_map=transform_to_wire(T_enu_map),
                )
            )
    return event


def map_move(version: int, first_seq: int, cause: int, translation_m: float, rotation_rad: float) -> pb.MapMove:
    return pb.MapMove(
        map_version=version,
        first_seq=first_seq,
        cause=cause,  # type: ignore[arg-type]
        translation_m=translation_m,
        rotation_rad=rotation_rad,
    )


def opened_event(epoch: int, seq: int, stamp_ns: int) -> pb.Event:
    return pb.Event(seq=seq, stamp_ns=stamp_ns, opened=pb.SessionOpened(epoch=epoch))


def ended_event(seq: int, stamp_ns: int) -> pb.Event:
    return pb.Event(seq=seq, stamp_ns=stamp_ns, ended=pb.SessionEnded(scans=seq))


def state_event(seq: int, stamp_ns: int, before: State, after: State) -> pb.Event:
    change = pb.StateChange(before=int(before), after=int(after))  # type: ignore[arg-type]
    return pb.Event(seq=seq, stamp_ns=stamp_ns, state=change)


def correction_event(seq: int, stamp_ns: int, correction: CorrectionRecord) -> pb.Event:
    return pb.Event(
        seq=seq,
        stamp_ns=stamp_ns,
        correction=types_pb.Correction(
            cause=int(correction.cause),  # type: ignore[arg-type]
            translation_m=correction.translation_m,
            rotation_rad=correction.rotation_rad,
        ),
    )


def loops_rejected_event(seq: int, stamp_ns: int, reason: str, count: int) -> pb.Event:
    return pb.Event(seq=seq, stamp_ns=stamp_ns, loops_rejected=pb.LoopsRejected(reason=reason, count=count))
