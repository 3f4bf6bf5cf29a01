"""One `WatchPoses` call: what it asks the store, and what it makes of that and of the answers given here.

`look` runs in a thread and changes nothing; everything else belongs to the event loop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Connection

from map_service.cursor import Cursor
from map_service.following import Scope, Standing, newest_key, standings
from map_service.live_answers import LiveAnswer
from map_service.moved import KnownMap, moved_keyframes
from map_service.pose_track import PoseTrack, TrackedScan
from map_service.scan_poses import read_lidar_body, stored_scans, versions
from map_service.store import Store
from splitslam.wire import pose_pb2 as pb

PAGE_SCANS = 200
_MOST_SCANS = 2000  # of one look, all sessions together

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Start:
    """Where a watch begins: after the cursor, but for sessions in `after_seq` after that scan.

    from_start: without a cursor, sessions that are there are told from their first scan on.
    """

    scope: Scope
    cursor: Cursor | None
    after_seq: Mapping[str, int]
    from_start: bool

    @property
    def known(self) -> dict[str, int]:
        """By session id: the newest scan that the caller has."""
        return {**(self.cursor.numbers if self.cursor else {}), **self.after_seq}


@dataclass(slots=True, eq=False)
class Followed:
    """A session that is followed. map_version: the one that the caller knows its keyframes in."""

    key: int
    track: PoseTrack
    T_lidar_body: Array
    map_version: int

    def has_all_of(self, row: Standing) -> bool:
        """Was everything told that the store has of it?"""
        return self.track.last >= row.last_seq and self.map_version == row.map_version


@dataclass(slots=True, eq=False)
class Found:
    """What a look at the store has found. more: there is more to be had at once."""

    standings: list[Standing]
    newest_key: int  # of all sessions
    new: dict[str, Followed] = field(default_factory=dict)
    scans: dict[str, list[TrackedScan]] = field(default_factory=dict)
    moved: dict[str, list[pb.MovedKeyframes]] = field(default_factory=dict)
    more: bool = False


class PoseWatch:
    """`look` and `take` by turns; `heard` whenever a frame is answered in this replica."""

    def __init__(self, store: Store, start: Start, backlog: int, count_dropped: Callable[[int], None]) -> None:
        """backlog: scans of a session that may wait. count_dropped: hears how many more were left out."""
        self._store, self._start, self._backlog, self._count_dropped = store, start, backlog, count_dropped
        self._followed: dict[str, Followed] = {}
        self._known: Mapping[str, int] = start.known
        # at the last look: what has a later one was opened since
        self._newest_key = start.cursor.newest_key if start.cursor else None
        self._looked = False
        self.done = False  # every session that was named has ended, and all of it was told
        self._dropped = 0

    # -- live ---------------------------------------------------------------------------------------------------

    def heard(self, answer: LiveAnswer) -> bool:
        """Is it an answer for this watch?"""
        one = self._followed.get(answer.session_id)
        if one is None:
            return False
        if (scan := answer.scan(one.T_lidar_body)) is not None:
            one.track.answered(answer.stream, scan)
        return True

    def take_live(self) -> Iterator[pb.WatchPosesResponse]:
        """What can be told without the store."""
        for one in self._followed.values():
            if poses := one.track.live():
                yield self._response(poses=poses)

    # -- store --------------------------------------------------------------------------------------------------

    def look(self) -> Found:
        """Asks the store, in one state of it. Raises StoreError, DataError."""
        with self._store.reading() as connection:
            known = self._followed
            names = known if self._looked else self._known
            rows = standings(connection, self._start.scope, names, self._newest_key)
            found = Found(rows, newest_key(connection))
            room = _MOST_SCANS
            for row in rows:
                one = known.get(row.session_id)
                if one is None or one.key != row.key:
                    one = found.new[row.session_id] = self._begun(connection, row)
                after_seq = one.track.next_after(row.last_seq)
                scans: list[TrackedScan] = []
                if row.last_seq > after_seq and room > 0:
                    page = row.key, row.session_id, after_seq, min(PAGE_SCANS, room)
                    scans = found.scans[row.session_id] = stored_scans(connection, *page, one.T_lidar_body)
                    room -= len(scans)
                if (scans[-1].seq if scans else after_seq) < row.last_seq:
                    found.more = True
                elif row.map_version > one.map_version:  # after all scans that were told in the versions before
                    known_map = KnownMap(row.key, row.session_id, one.map_version, row.map_version)
                    found.moved[row.session_id] = moved_keyframes(connection, known_map)
            return found

    def _begun(self, connection: Connection, row: Standing) -> Followed:
        """Where to begin with a session that is new here."""
        T_lidar_body = read_lidar_body(connection, row.key)
        if row.session_id in self._known and not self._looked:
            after_seq = self._known[row.session_id]
        elif self._start.from_start or (self._newest_key is not None and row.key > self._newest_key):
            after_seq = 0
        else:
            track = PoseTrack(row.last_seq, row.last_seq, self._backlog)
            return Followed(row.key, track, T_lidar_body, row.map_version)
        track = PoseTrack(after_seq, row.last_seq, self._backlog)
        known_version = versions(connection, row.key).of(max(after_seq, 1))
        return Followed(row.key, track, T_lidar_body, known_version)

    def take(self, found: Found) -> Iterator[pb.WatchPosesResponse]:
        """What a look has found, as far as it is new."""
        for session_id, one in found.new.items():
            self._followed[session_id] = one
        news = bool(found.new)
        self._newest_key, self._looked = found.newest_key, True
        there = {row.session_id: row for row in found.standings}
        for session_id in [name for name in self._followed if name not in there]:
            del self._followed[session_id]
        for session_id, row in there.items():
            one = self._followed[session_id]
            if dropped := one.track.leave_out(row.last_seq):
                self._dropped += dropped
                self._count_dropped(dropped)
            if poses := one.track.stored(found.scans.get(session_id, ())):
                news = True
                yield self._response(poses=poses)
            for moved in found.moved.get(session_id, ()):
                yield self._response(moved=moved)
            if session_id in found.moved:
                one.map_version = row.map_version
        ended = {name for name, row in there.items() if row.finished and self._followed[name].has_all_of(row)}
        if self._start.scope.session_ids:
            self.done = ended == set(there)
        else:
            for session_id in ended:
                del self._followed[session_id]
        if news:
            yield self.alive()

    def alive(self) -> pb.WatchPosesResponse:
        """A sign of life, and what the caller has by now."""
        response = self._response()
        if self._newest_key is not None:
            numbers = {session_id: one.track.last for session_id, one in self._followed.items()}
            response.cursor = Cursor(self._newest_key, numbers).text()
        return response

    def _response(
        self, poses: list[pb.ScanPose] | None = None, moved: pb.MovedKeyframes | None = None
    ) -> pb.WatchPosesResponse:
        return pb.WatchPosesResponse(poses=poses or (), moved=moved, dropped=self._dropped)
