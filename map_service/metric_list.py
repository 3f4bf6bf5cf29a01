"""Every metric of the map service. What robots say is a label in the gauges by robot alone, a list of their own."""

from __future__ import annotations

from typing import get_args

from map_service.callers import Reason
from map_service.robot_metric_list import ROBOT_METRICS
from map_service.types import Cause, State
from splitslam.metrics.definition import Label, Metric, counter, gauge, histogram

_ANSWER_S = (0.002, 0.004, 0.006, 0.01, 0.015, 0.025, 0.04, 0.06, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
_STAGE_S = (0.0005, 0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.015, 0.025, 0.05, 0.1, 0.25, 1.0)
_COMMIT_S = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0)
_COMMIT_BYTES = (512.0, 2048.0, 8192.0, 32768.0, 131072.0, 524288.0, 2097152.0, 8388608.0)
_SHARES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 1.0)
_METRES = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 50.0)

STATES = (*(state.name.lower() for state in State), "detached")
REFUSALS = ("overloaded", "unauthenticated", "version", "quota", "finished", "bad_hello", "fenced", "store")
REJECTIONS = ("corrupt", "codec_version", "time", "failed")
CAUSES = tuple(cause.name.lower() for cause in Cause)
LOOP_RESULTS = (
    *("accepted", "no_match", "not_converged", "few_inliers", "one_sided", "tipped", "ambiguous", "implausible"),
    *("unsupported", "failed", "verifier_died", "store_away"),
)
GNSS_RESULTS = (
    *("accepted", "gated", "spacing", "covariance", "no_fix", "duplicate", "out_of_order", "late", "early", "lost"),
    "unusable",
)
DENSE_VERDICTS = ("stored", "not_a_keyframe", "not_yet", "refused", "no_room", "no_session")
_WORKER = Label("worker", bound="`workers`: 0, 1, ...")

# --- robots and streams -----------------------------------------------------------------------------------------------

SESSIONS = gauge(
    "splitslam_map_sessions",
    "Sessions in memory by tracking state; detached: without a stream",
    "lost, localising: those robots cannot use their pose. detached: robots that went away without Bye.",
    Label("state", STATES),
)
STREAMS = gauge(
    "splitslam_map_streams",
    "Streams open",
    "Against `session_limit`. Falls to 0 on one replica: its health, Envoy.",
)
SESSION_LIMIT = gauge(
    "splitslam_map_session_limit",
    "Robots that this replica serves at once",
    "`streams` near it: more workers or replicas.",
)
REFUSED = counter(
    "splitslam_map_refused",
    "Streams refused, by reason",
    "overloaded: capacity. store: the database. unauthenticated, bad_hello, version: that robot's configuration.",
    Label("reason", REFUSALS, open=True),
)
DENIED = counter(
    "splitslam_map_auth_refused",
    "Calls of who may not, or too often, by reason (docs/security.md)",
    "One robot: its certificate or token. Many at once: an authority that has expired, or somebody who tries.",
    Label("reason", get_args(Reason)),
)
HANDSHAKES = counter(
    "splitslam_map_tls_handshakes", "TLS handshakes begun", "Many more than streams: connections that are refused."
)
THROTTLED = counter(
    "splitslam_map_throttled_messages",
    "Messages that came too fast and waited",
    "A robot that floods; `limits.client`.",
)
CERTIFICATE_EXPIRY = gauge(
    "splitslam_map_certificate_expiry_timestamp_seconds",
    "When the service's certificate or an authority expires, whichever is first; NaN: no TLS",
    "Less than its renewal ahead: `splitslam certs`.",
)
STREAM_ENDS = counter(
    "splitslam_map_stream_ends",
    "Streams that were open and ended. ok: by us, as they should. cancelled: the robot, the link or the proxy went. "
    "Others: the status that we ended them with",
    "cancelled: links. unavailable: workers that died or a drain. internal: the service's log.",
    Label(
        "status",
        ("ok", "cancelled", "unavailable", "aborted", "invalid_argument", "internal", "unauthenticated"),
        open=True,
    ),
)
RECEIVED_BYTES = counter(
    "splitslam_map_received_bytes", "Serialized messages of robots", "By `frames_total`: bytes a frame."
)
SENT_BYTES = counter("splitslam_map_sent_bytes", "Serialized messages to robots", "As above.")
DRAINED = counter(
    "splitslam_map_drained",
    "Robots sent to another replica",
    "rebalance all the time: replicas that come and go.",
    Label("reason", ("shutdown", "rebalance")),
)
FENCED = counter(
    "splitslam_map_fenced",
    "Sessions given up here because another stream or replica owns them",
    "Normal after a freeze or a partition; all the time: two agents with one run id.",
)
REPLICAS = gauge(
    "splitslam_map_replicas",
    "Replicas alive by the store; 0: not shared",
    "Fewer than deployed: one cannot reach the store.",
)
DRAINING = gauge("splitslam_map_draining", "1 while this replica takes no new streams and shuts down", "A roll-out.")

WATCHERS = gauge(
    "splitslam_map_watchers",
    "Calls that follow sessions, by kind",
    "At `watch.most` more are refused.",
    Label("call", ("poses", "events")),
)
WATCH_DROPPED = counter(
    "splitslam_map_watch_dropped_scans",
    "Scans left out for followers that read too slowly",
    "Rises: one of them hangs, or its network is too slow.",
)

# --- frames -----------------------------------------------------------------------------------------------------------

FRAMES = counter(
    "splitslam_map_frames",
    "Frames by result. duplicate: answered before. missing: declared lost by the robot. gap: not the next one, the "
    "stream was ended. failed: the pipeline raised",
    "rejected: `rejected_total`. missing: robots' spools are full. failed: a defect, the log has it.",
    Label("result", ("mapped", "duplicate", "rejected", "missing", "gap", "failed")),
)
REJECTED = counter(
    "splitslam_map_rejected",
    "Frames answered with a rejection, by reason",
    "corrupt: link or memory. codec_version: an agent newer than this service. time: that robot's clock.",
    Label("reason", REJECTIONS, open=True),
)
ANSWER_SECONDS = histogram(
    "splitslam_map_answer_seconds",
    "A frame received until its answer is handed to gRPC",
    "`queue_frames`, `worker_busy_seconds`: too many robots a worker, or one long job.",
    _ANSWER_S,
)
OLDEST_FRAME = gauge(
    "splitslam_map_oldest_frame_seconds",
    "How long the oldest unanswered frame has waited",
    "Above `limits.max_delay_s` no new robots are taken.",
)
STAGE_SECONDS = histogram(
    "splitslam_map_stage_seconds",
    "Thread CPU time of one mapped frame: registration, graph (loops, GNSS and rebuilds of the local map included)",
    "registration: local map too dense, bad predictions (`registration_iterations`). graph: long sessions.",
    _STAGE_S,
    Label("stage", ("registration", "graph")),
)
KEYFRAMES = counter(
    "splitslam_map_keyframes", "Keyframes made", "Many more a frame than usual: robots turn a lot, or are lost."
)

# --- registration, graph ----------------------------------------------------------------------------------------------

REGISTRATIONS = counter(
    "splitslam_map_registrations",
    "Scans registered with the local map, by what came of it. degenerate: a direction was not observed; its share is "
    "that of all. bare: frames without features",
    "degenerate: tunnels, halls, fog; or a covered sensor.",
    Label("result", ("observed", "degenerate", "bare")),
)
ITERATIONS = histogram(
    "splitslam_map_registration_iterations",
    "Levenberg-Marquardt steps of one registration",
    "More: worse predictions, as without IMU or with a wrong mounting.",
    (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 50.0),
)
INLIERS = histogram(
    "splitslam_map_registration_inlier_ratio",
    "Features within 3 sigma of the local map, as a share of all",
    "Less: moving things, a changed site, a wrong pose, a beam table that is off.",
    _SHARES,
)
CORRECTIONS = counter(
    "splitslam_map_corrections",
    "Stated jumps of T_map_odom, by cause",
    "relocalise: robots that were lost. registration: maps that are being levelled. gnss often: multipath.",
    Label("cause", CAUSES),
)
CORRECTION_METRES = histogram(
    "splitslam_map_correction_metres",
    "How far T_map_lidar moved in them",
    "Metres by gnss or loop: look at that robot's map before it is used.",
    _METRES,
)
LOOP_CANDIDATES = counter(
    "splitslam_map_loop_candidates",
    "Places compared: near by the graph, or alike by their looks",
    "looks without accepted loops: a site that repeats itself.",
    Label("kind", ("near", "looks")),
)
LOOPS = counter(
    "splitslam_map_loops",
    "Loop closures that are durable: accepted into the graph, or why not",
    "ambiguous, implausible: places that are alike. few_inliers, one_sided: a changed site. verifier_died: memory. "
    "store_away: it had the older clouds.",
    Label("result", LOOP_RESULTS, open=True),
)
GNSS = counter(
    "splitslam_map_gnss",
    "GNSS fixes that are durable: accepted into the graph, or why not. spacing: more than are needed",
    "gated: multipath, or a wrong antenna position. late, out_of_order: the receiver's clock. covariance: none given.",
    Label("result", GNSS_RESULTS, open=True),
)

# --- store ------------------------------------------------------------------------------------------------------------

COMMITS = counter(
    "splitslam_map_commits",
    "Commits by result; retried counts tries, the others ends. fenced: another owner has the session",
    "retried, failed: the database. fenced: see `fenced_total`.",
    Label("result", ("ok", "retried", "fenced", "failed")),
)
COMMIT_SECONDS = histogram(
    "splitslam_map_commit_seconds",
    "One commit, tries included",
    "The database's disk and load; above 1 s new sessions wait.",
    _COMMIT_S,
)
COMMIT_BYTES = histogram(
    "splitslam_map_commit_bytes",
    "What one commit adds to the store, without the database's own overhead",
    "By its sum: growth of the store; `store_bytes`, `retention_bytes_total`.",
    _COMMIT_BYTES,
)
UNDURABLE = gauge(
    "splitslam_map_undurable_frames",
    "Frames applied and not durable yet, all sessions",
    "Grows: the store is slow or away; at `commit.backlog_frames` a session waits.",
)
DENSE_CLOUDS = counter(
    "splitslam_map_dense_clouds",
    "Whole scans of keyframes that robots have offered, by what became of them; stored: also those that it had already",
    "refused: the log says what is wrong with them. no_room: the site's quota. not_yet: commits that are late.",
    Label("verdict", DENSE_VERDICTS),
)
DENSE_BYTES = counter(
    "splitslam_map_dense_bytes",
    "Bytes of those that were stored",
    "A share of `store_bytes`; robots send them with `uplink.dense: idle`.",
)
STORE_BYTES = gauge(
    "splitslam_map_store_bytes",
    "What the sessions of a site have stored; only sites that the configuration names, all others together",
    "Against that site's quota.",
    Label("site", bound="sites with a quota or a retention in the configuration, and `other`"),
)
DATABASE_BYTES = gauge(
    "splitslam_map_database_bytes", "The store as it lies on disk", "Against the room of its volume; retention."
)
RETENTION = counter(
    "splitslam_map_retention_sessions",
    "Finished sessions deleted for age",
    "None for long: `retention` in the configuration.",
)
RETENTION_BYTES = counter("splitslam_map_retention_bytes", "What they had stored", "As above.")

VIEWERS = gauge(
    "splitslam_map_viewers",
    "Viewers that watch this replica's sessions",
    "Each costs its worker about a millisecond a scan of what it watches; none: nothing.",
)
VIEWS_MISSED = counter(
    "splitslam_map_views_missed",
    "Scans that a viewer was not shown because it did not read in time",
    "A viewer that hangs, or its link. No robot waits for it.",
)

# --- workers ----------------------------------------------------------------------------------------------------------

QUEUE_FRAMES = gauge(
    "splitslam_map_queue_frames",
    "Frames waiting for an answer, by worker",
    "One worker far above the others: one robot's long job.",
    _WORKER,
)
QUEUE_MESSAGES = gauge(
    "splitslam_map_worker_queue_messages",
    "Messages in a worker's queue, of at most `limits.worker_queue_messages`",
    "Near the limit: that worker cannot keep up.",
    _WORKER,
)
WORKER_BUSY = gauge(
    "splitslam_map_worker_busy_seconds",
    "How long a worker has been at its present job",
    "Above 1 s: a session is built again, or a loop far back is optimised; killed at `limits.stall_s`.",
    _WORKER,
)
WORKER_CPU = counter(
    "splitslam_map_worker_cpu_seconds",
    "CPU time of a worker and its loop verifiers",
    "Near one core a worker: no room for more robots.",
    _WORKER,
)
WORKER_MEMORY = gauge(
    "splitslam_map_worker_resident_memory_bytes",
    "Resident memory of a worker",
    "Grows with sessions held and their length; without them: a leak, report it.",
    _WORKER,
)
WORKERS_READY = gauge(
    "splitslam_map_workers_ready",
    "Workers that are warm and take streams",
    "Fewer than configured: the log says why one died.",
)
WORKER_RESTARTS = counter(
    "splitslam_map_worker_restarts",
    "Workers that died and were started again",
    "Memory of the machine; the service's log.",
)

SERVICE_METRICS = tuple(value for value in tuple(globals().values()) if isinstance(value, Metric))
MAP_METRICS = (*SERVICE_METRICS, *ROBOT_METRICS)
