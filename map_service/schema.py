"""Tables of the store as this version makes them; map_service/migrations.py says what came when."""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    Float,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
    Text,
)

metadata = MetaData()
_row_id = BigInteger().with_variant(Integer, "sqlite")  # only INTEGER is an alias of SQLite's rowid


def _session_key(ondelete: str | None = None) -> Column:
    return Column("session", _row_id, ForeignKey("sessions.id", ondelete=ondelete), primary_key=True)


meta = Table("meta", metadata, Column("key", String(64), primary_key=True), Column("value", Text, nullable=False))

sessions = Table(
    "sessions",
    metadata,
    # A surrogate key that is never used again: an owner of a deleted session cannot write into its successor.
    Column("id", _row_id, primary_key=True, autoincrement=True),
    Column("session_id", String(180), nullable=False, unique=True),
    Column("robot_id", String(128), nullable=False),
    Column("run_id", String(64), nullable=False),
    Column("site_id", String(128), nullable=False),
    Column("map_id", String(128), nullable=False),
    Column("robot_file", Text, nullable=False),
    Column("opened_s", Float, nullable=False),
    Column("epoch", BigInteger, nullable=False),
    Column("last_seq", BigInteger, nullable=False),
    Column("finished", Boolean, nullable=False),
    Column("first_stamp_ns", BigInteger, nullable=False),
    Column("last_stamp_ns", BigInteger, nullable=False),
    Column("frames", BigInteger, nullable=False),
    Column("rejected", BigInteger, nullable=False),
    Column("keyframes", BigInteger, nullable=False),
    Column("loops", BigInteger, nullable=False),
    Column("gnss_factors", BigInteger, nullable=False),
    Column("bytes", BigInteger, nullable=False),
    Column("tracker", LargeBinary, nullable=False),
    Column("statistics", Text, nullable=False),
    Column("finished_s", Float),  # null: not finished, or by a service that did not know it
    # null: by services that did not know them
    Column("map_version", Integer),
    Column("events", BigInteger),  # number of the newest
    Index("sessions_by_site", "site_id"),
    sqlite_autoincrement=True,
)

# Poses are 7 little-endian float64: x y z, qx qy qz qw. A rejected frame has its reason and no poses.
frames = Table(
    "frames",
    metadata,
    _session_key(),
    Column("seq", BigInteger, primary_key=True),
    Column("stamp_ns", BigInteger, nullable=False),
    Column("state", Integer, nullable=False),
    Column("keyframe", Integer),
    Column("pose_keyframe_lidar", LargeBinary),
    Column("online_map_lidar", LargeBinary),
    Column("online_map_odom", LargeBinary),
    Column("rejected", String(64), nullable=False),
    Column("covariance", LargeBinary),  # of the answer, as rows.pack_covariance has it
    Index("frames_by_stamp", "session", "stamp_ns"),
)

keyframes = Table(
    "keyframes",
    metadata,
    _session_key(),
    Column("keyframe", Integer, primary_key=True),
    Column("seq", BigInteger, nullable=False),
    Column("stamp_ns", BigInteger, nullable=False),
    Column("pose_map_lidar", LargeBinary, nullable=False),
)

# Apart from the poses: a loop moves every pose, and SQLite writes a whole row anew.
clouds = Table(
    "clouds",
    metadata,
    _session_key(),
    Column("keyframe", Integer, primary_key=True),
    Column("cloud", LargeBinary, nullable=False),
)

factors = Table(
    "factors",
    metadata,
    _session_key(),
    Column("factor", BigInteger, primary_key=True),
    Column("kind", String(16), nullable=False),
    Column("payload", LargeBinary, nullable=False),
)

# Sequence numbers that the robot gave up and said so: the frame after the hole and the one before it.
holes = Table(
    "holes",
    metadata,
    _session_key(ondelete="CASCADE"),
    Column("seq", BigInteger, primary_key=True),
    Column("follows_seq", BigInteger, nullable=False),
)

# What loop closure knows keyframes by (map_service/places.py). Made again from the clouds it would hold up a restart.
places = Table(
    "places",
    metadata,
    _session_key(ondelete="CASCADE"),
    Column("keyframe", Integer, primary_key=True),
    Column("descriptor", LargeBinary, nullable=False),
)

# A row for each version of a session's map but the first: which frame began it and why (map_service/map_versions.py).
# poses: T_map_lidar of all keyframes as the version before ended, 7 float64 each; null: no longer kept.
map_versions = Table(
    "map_versions",
    metadata,
    _session_key(ondelete="CASCADE"),
    Column("version", Integer, primary_key=True),
    Column("first_seq", BigInteger, nullable=False),
    Column("cause", Integer, nullable=False),
    Column("translation_m", Float, nullable=False),
    Column("rotation_rad", Float, nullable=False),
    Column("poses", LargeBinary),
)

# The newest of each session, numbered 1, 2, 3, ...; content: splitslam.v1.Event.
events = Table(
    "events",
    metadata,
    _session_key(ondelete="CASCADE"),
    Column("number", BigInteger, primary_key=True),
    Column("content", LargeBinary, nullable=False),
)

# Whole scans of keyframes as their robot has sent them (splitslam.dense_cloud): those that have come.
dense_clouds = Table(
    "dense_clouds",
    metadata,
    _session_key(ondelete="CASCADE"),
    Column("keyframe", Integer, primary_key=True),
    Column("cloud", LargeBinary, nullable=False),
)

SESSION_TABLES = (
    frames,
    clouds,
    keyframes,
    factors,
    holes,
    places,
    map_versions,
    events,
    dense_clouds,
)  # all that refers to a session
