"""Every metric of the edge agent. A robot is a target of its own: no metric here names it."""

from __future__ import annotations

from splitslam.metrics.definition import Label, Metric, counter, gauge, histogram

_TIMES_S = (0.0005, 0.001, 0.002, 0.004, 0.008, 0.016, 0.032, 0.064, 0.128, 0.256, 0.512, 1.024, 4.096)
_AGES_S = (0.01, 0.02, 0.03, 0.05, 0.075, 0.1, 0.15, 0.2, 0.3, 0.5, 1.0, 2.0, 5.0, 15.0, 60.0, 300.0, 3600.0)
_POINT_BYTES = (0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 3.0, 3.5, 4.0, 6.0, 8.0)

STREAMS = ("lidar", "imu", "wheels", "gnss")
STAGES = ("motion", "deskew", "features", "encode", "total")
BACK_ENDS = ("reference", "cpu", "fpga", "cosim", "off", "rotation")
UPLINK_KINDS = ("hello", "frame", "bye", "report", "dense")
DOWNLINK_KINDS = ("welcome", "odometry", "credit", "advice", "drain", "refused", "finished", "dense")
DENSE_LOSSES = (
    *("full", "disk", "damaged", "busy", "motion", "encode", "killed", "refused", "deleted", "not_a_keyframe"),
)
CAUSES = ("loop", "gnss", "relocalise", "registration", "outage")

_OF_A_STREAM = ("duplicate", "time_backwards", "time_jump")
DROP_REASONS = (
    # a scan, before it is a frame
    *("decode", "point_time", "empty", "nan", "few_points", "budget", "motion", "too_many_features", "queue_full"),
    *_OF_A_STREAM,
    # a message of any live sensor, from before its clock was locked
    "clock_changed",
    "clock_unknown",
    # messages of the other sensors
    *("imu_nan", "imu_range", *(f"imu_{reason}" for reason in _OF_A_STREAM)),
    *("wheel_nan", "wheel_range", *(f"wheel_{reason}" for reason in _OF_A_STREAM)),
    *("gnss_nan", "gnss_no_fix", *(f"gnss_{reason}" for reason in _OF_A_STREAM)),
    # a frame
    *("buffer_full", "buffer_full_after_answer", "spool_damaged"),
    *(f"rejected_{reason}" for reason in ("corrupt", "codec_version", "time", "failed", "corrupt_answer")),
    # a pose, for a reader of the feed
    "feed_slow_reader",
    # messages of a ROS graph: from it, to it
    *("ros_lost", "ros_scan_missing", "ros_imu_missing", "ros_inbox_full", "ros_failed"),
    *("ros_queue_full", "ros_not_sent", "ros_no_odom"),
)
BREAKS = (
    *("no_welcome", "silent", "unanswered", "drain", "refused", "ended_by_server"),
    *("unavailable", "cancelled", "internal", "aborted", "unauthenticated", "permission_denied"),
    *("resource_exhausted", "deadline_exceeded", "unimplemented", "invalid_argument", "unknown"),
)

SENSORS = ("lidar", "imu", "gnss")
PACKET_RESULTS = (
    # what became of a packet, or of a message in a stream of bytes
    *("used", "unused", "start", "duplicate", "late", "size", "foreign", "model", "sender", "checksum", "garbage"),
    # and besides
    *("lost", "reordered", "overflow", "disconnects"),
)
CLOCK_CHOICES = ("gps", "ptp", "host")

# --- scans ------------------------------------------------------------------------------------------------------------

SCANS = counter(
    "splitslam_edge_scans",
    "Scans by how far they came. read: from the sensor. sent: encoded and handed to the uplink. mapped, rejected: by "
    "the service's answer. replayed: answers to frames of an agent before",
    "read without sent: `dropped_total`. sent without mapped: `buffer_frames`, `reconnects_total`.",
    Label("result", ("read", "sent", "mapped", "rejected", "replayed")),
)
DROPPED = counter(
    "splitslam_edge_dropped",
    "What was lost, by reason: scans, messages of other sensors (imu_, wheel_, gnss_), frames (buffer_full, "
    "spool_damaged, rejected_), poses for a slow reader of the feed or for ROS (ros_queue_full, ros_not_sent, "
    "ros_no_odom). buffer_full_after_answer: lost only if the service loses it as well",
    "The reason: sensor and driver (nan, decode, point_time, time_*), CPU (queue_full), link and disk (buffer_full), "
    "versions (rejected_codec_version).",
    Label("reason", DROP_REASONS, open=True),
)
STAGE_SECONDS = histogram(
    "splitslam_edge_stage_seconds",
    "Thread CPU time of one scan in each stage; total: of all stages",
    "Ten times the usual: another deskew back end (`deskew_back_end`), throttling, other programs' cache.",
    _TIMES_S,
    Label("stage", STAGES),
)
STAGE_WALL_SECONDS = histogram(
    "splitslam_edge_stage_wall_seconds",
    "The same by the wall's clock",
    "Longer than the CPU time: others have the processor; see priority and affinity of the unit.",
    _TIMES_S,
    Label("stage", STAGES),
)
SCAN_AGE_SECONDS = histogram(
    "splitslam_edge_scan_age_seconds",
    "Age of a scan when its frame is put on a stream: since the scan came from its driver; a frame that is sent again "
    "counts again",
    "Grows with `queue_events` (CPU), `buffer_frames` (link, budget); during back-fill it is the outage's length.",
    _AGES_S,
)
POINT_BYTES = histogram(
    "splitslam_edge_point_bytes",
    "Encoded bytes a point of one frame, motion and all included; times 8: bits per point",
    "More without more range or rotation: a sensor that is loose or dirty, rain, a wrong beam table.",
    _POINT_BYTES,
    Label("frame", ("dense", "sparse")),
)
QUEUE_EVENTS = gauge(
    "splitslam_edge_queue_events",
    "Sensor messages read and not yet processed",
    'Grows: the agent is slower than its sensors; `stage_seconds`, `dropped_total{reason="queue_full"}`.',
)
SILENT_SECONDS = gauge(
    "splitslam_edge_sensor_silent_seconds",
    "Since the last message of each sensor that has ever said anything; NaN for one that has not",
    "Beyond a few periods: cable, driver, power of that sensor.",
    Label("stream", STREAMS),
)
CLOCK_STEPS = counter(
    "splitslam_edge_clock_steps",
    "Steps of a sensor's clock, or restarts of its driver, that did not reach the run",
    "Time synchronisation of that sensor (PTP, NTP), or a driver that restarts.",
    Label("stream", STREAMS),
)

# --- IMU, deskew, odometry --------------------------------------------------------------------------------------------

IMU_GAPS = counter(
    "splitslam_edge_imu_gaps",
    "Times without samples that are longer than interpolation may bridge",
    "Cable and driver of the IMU; then `sensor_silent_seconds`.",
)
IMU_GAP_SECONDS = counter(
    "splitslam_edge_imu_gap_seconds",
    "How long they were",
    "As above.",
)
UNCOVERED = counter(
    "splitslam_edge_uncovered_scans",
    "Scans that went on without the IMU reaching their end",
    "The IMU is silent, or its stamps are late: `splitslam check`.",
)
IMU_RESETS = counter(
    "splitslam_edge_imu_resets",
    "Times the Imu node has begun anew, as its solution could not be used",
    "`check_rotation_radians`, `check_time_offset_seconds`, IMU noise in the robot file.",
)
BACK_END = gauge(
    "splitslam_edge_deskew_back_end",
    "1 for the deskew back end in force",
    "cpu where fpga is expected: the start's log says why the overlay was not used.",
    Label("name", BACK_ENDS),
)
DESKEW_TROUBLES = counter(
    "splitslam_edge_deskew_troubles",
    "Scans done on the CPU for want of an answer of the logic, by cause; unusable_points: those no deskew can move",
    "timeout, dma, answer: the board and its bitstream; size, motion: the sensor.",
    Label("cause", ("timeout", "dma", "answer", "self_test", "size", "motion", "unusable_points"), open=True),
)
ODOMETRY_SECONDS = histogram(
    "splitslam_edge_odometry_seconds",
    "Thread CPU time of the edge's own odometry for one scan, while it is at work",
    "With `stage_seconds` it must stay below a scan period.",
    _TIMES_S,
)
ODOMETRY_SCANS = counter(
    "splitslam_edge_odometry_scans",
    "Scans placed by the edge's own odometry, by how that went",
    "failed: nothing to hold on to; the IMU carries the pose and drift grows fast.",
    Label("result", ("placed", "degenerate", "failed")),
)
OUTAGES = counter(
    "splitslam_edge_outages",
    "Times without answers of the map service",
    "`reconnects_total` says who ended the stream; many short ones: radio coverage.",
)
OUTAGE_SECONDS = counter("splitslam_edge_outage_seconds", "How long they were", "As above.")
ALONE = gauge(
    "splitslam_edge_alone",
    "1 while the edge goes by its own odometry",
    "The link and the service; how far the pose can be trusted: `odometry_scans_total`.",
)
STATE = gauge(
    "splitslam_edge_state",
    "Tracking state: 1 initialising, 2 tracking, 3 degenerate, 4 unanchored, 5 localising, 6 lost (TrackingState)",
    "4: link or service. 3: where the robot is. 5 and 6: the pose must not be used.",
)
CORRECTIONS = counter(
    "splitslam_edge_corrections",
    "Stated jumps of T_map_odom, by cause",
    "relocalise: the robot was lost. outage: drift while the service was away. Many of gnss: multipath.",
    Label("cause", CAUSES, open=True),
)

# --- the link ---------------------------------------------------------------------------------------------------------

UPLINK_BYTES = counter(
    "splitslam_edge_uplink_bytes",
    "Serialized messages sent, by kind",
    "Against `uplink_limit_bytes_per_second`; hello: streams that break.",
    Label("kind", UPLINK_KINDS, open=True),
)
DOWNLINK_BYTES = counter(
    "splitslam_edge_downlink_bytes",
    "Serialized messages received, by kind",
    "odometry without more scans: repeated answers; refused: the service's capacity.",
    Label("kind", DOWNLINK_KINDS, open=True),
)
TCP_SENT = counter(
    "splitslam_edge_tcp_sent_bytes",
    "TCP payload sent to the service by the kernel's count: HTTP/2, gRPC and TLS included",
    "Much more than `uplink_bytes_total`: connections that are made again and again.",
)
TCP_RECEIVED = counter("splitslam_edge_tcp_received_bytes", "The same, received", "As above.")
LIMIT = gauge(
    "splitslam_edge_uplink_limit_bytes_per_second",
    "Budget of the uplink, the configuration's or the service's advice; NaN: none",
    "Lower than configured: the service advises it.",
)
WITHHELD = counter(
    "splitslam_edge_withheld_points",
    "Features that the budget left no room for",
    "The budget is the bottleneck: raise `uplink.max_kbps`, or accept less accuracy.",
)
ROUND_TRIP_SECONDS = histogram(
    "splitslam_edge_round_trip_seconds",
    "A frame handed to the uplink until its answer",
    "With the service's `answer_seconds`: what is left is the link.",
    _AGES_S,
)
ANSWER_AGE = gauge(
    "splitslam_edge_answer_age_seconds",
    "Since the last answer of the service; NaN before the first",
    "Above 1.5 s: link, proxy or service; `reconnects_total`.",
)
CONNECTED = gauge(
    "splitslam_edge_connected",
    "1 while a stream is open and was welcomed",
    "0: `reconnects_total` by cause; the agent's log names the address.",
)
CONNECTS = counter(
    "splitslam_edge_connects",
    "Streams that were answered with a Welcome",
    "Grows: streams break and come back, see `reconnects_total`.",
)
RECONNECTS = counter(
    "splitslam_edge_reconnects",
    "Streams that ended before their time, by who or what ended them: the agent's own watch (no_welcome, silent, "
    "unanswered), the service (drain, refused, ended_by_server), gRPC's status",
    "silent, unavailable: the link. no_welcome, unanswered: the service is overloaded or frozen. refused: its log.",
    Label("cause", BREAKS, open=True),
)
CERTIFICATE_EXPIRY = gauge(
    "splitslam_edge_certificate_expiry_timestamp_seconds",
    "When the agent's certificate or its authority expires, whichever is first; NaN: no TLS",
    "Less than its renewal ahead: `splitslam certs`.",
)
IGNORED = counter(
    "splitslam_edge_ignored_answers",
    "Answers not handed on: known before, or to no frame of ours",
    "duplicate: normal after a reconnect. unexpected: a defect, report it.",
    Label("cause", ("duplicate", "unexpected")),
)

# --- what is kept -----------------------------------------------------------------------------------------------------

BUFFER_FRAMES = gauge(
    "splitslam_edge_buffer_frames",
    "Frames kept until they are answered and durable at the service",
    "Grows: no link, or the service's store is away (`durable_seq` stands).",
)
BUFFER_BYTES = gauge("splitslam_edge_buffer_bytes", "Their bytes", "As above.")
SPOOL_FRAMES = gauge(
    "splitslam_edge_spool_frames",
    "Of the kept frames, those on disk",
    "Fewer than `buffer_frames`: the disk does not take them, see `spool_errors_total`.",
)
SPOOL_BYTES = gauge(
    "splitslam_edge_spool_bytes",
    "Bytes of the spool's files of this run",
    "Against `spool_limit_bytes`: at three quarters the least missed frames go.",
)
SPOOL_LIMIT = gauge(
    "splitslam_edge_spool_limit_bytes",
    "Room of the spool, all runs together; 0: there is no spool",
    "0 on a robot: `state_dir` or `spool.dir` is missing in the configuration.",
)
DENSE_WAITING = gauge(
    "splitslam_edge_dense_waiting",
    "Whole scans on the disk that the service has not stored (`uplink.dense: idle`)",
    "Only grows: the link is never idle, or the service takes none.",
)
DENSE_BYTES = gauge(
    "splitslam_edge_dense_bytes",
    "Their bytes",
    "Against `uplink.dense_max_mb`: beyond it the oldest go.",
)
DENSE_SENT = counter(
    "splitslam_edge_dense_sent",
    "Whole scans of keyframes that the service has stored",
    "Against the keyframes of the run.",
)
DENSE_DROPPED = counter(
    "splitslam_edge_dense_dropped",
    "Whole scans of keyframes that were lost, by reason. motion: of a scan whose motion was not known yet; busy: they "
    "came too fast; killed: an agent before had it in memory; deleted: the session is gone; not_a_keyframe: the "
    "service has forgotten that it was one",
    "full: `uplink.dense_max_mb`, or a link that is never idle. disk, damaged: the disk. busy: CPU.",
    Label("reason", DENSE_LOSSES, open=True),
)
SPOOL_ERRORS = counter(
    "splitslam_edge_spool_errors",
    "What the disk did not do (full, read_only, permission, io), what was found damaged or torn on it, and frames that "
    "the service refused for good",
    "The disk's health and room. refused: frames lie in `refused/`, the log names the folder.",
    Label("kind", ("full", "read_only", "permission", "io", "damaged", "torn", "refused"), open=True),
)

# --- live sensors -----------------------------------------------------------------------------------------------------

SENSOR_PACKETS = counter(
    "splitslam_edge_sensor_packets",
    "Packets of live sensors by what became of them (a serial device's or a receiver's messages). used, unused (other "
    "data), start (of a turn whose beginning nobody saw), duplicate, late (its turn is gone), size, foreign, model (of "
    "another lidar), sender (another address), checksum, garbage (bytes between messages). Besides: reordered (used, "
    "but came late), lost (never came), overflow (lost in our own buffer), disconnects of a device or server",
    "lost without overflow: the sensor's network. overflow: CPU, `receive_bytes`. model, foreign: the port is another "
    "sensor's. checksum, garbage: baud rate, cable.",
    Label("sensor", SENSORS),
    Label("result", PACKET_RESULTS, open=True),
)
SENSOR_LOSSES = counter(
    "splitslam_edge_sensor_losses",
    "How often a live sensor has fallen silent; the run goes on without it, and with it when it is back",
    "Cable, power, network of the sensor; `silent_seconds` says for how long.",
    Label("sensor", SENSORS),
)
CLOCK_CHOSEN = gauge(
    "splitslam_edge_sensor_clock",
    "1 where a live sensor's stamps are taken from: its own time, locked to GPS or PTP, or when its messages come",
    "host where gps or ptp is wired: PPS and $GPRMC, PTP's grandmaster; the log says why.",
    Label("sensor", SENSORS),
    Label("taken_from", CLOCK_CHOICES),
)
CLOCK_CHANGES = counter(
    "splitslam_edge_sensor_clock_changes",
    "How often a live sensor's lock to GPS or PTP has come or gone while the run went on, without a step in its time",
    "Antenna and pulse of the receiver, PTP's grandmaster; the log says when, and by how much the clock stepped.",
    Label("sensor", SENSORS),
)
CLOCK_BEHIND = gauge(
    "splitslam_edge_sensor_clock_behind_seconds",
    "By how much a live sensor's clock is behind ours, its messages' way included; NaN: not known yet",
    "Of sensors that are locked to the same time they differ by little more than the way.",
    Label("sensor", SENSORS),
)
CLOCK_PROBLEMS = gauge(
    "splitslam_edge_sensor_clock_problems",
    "Live sensors whose clocks are not as the configuration says, or not as each other's",
    "The log and the status line name each.",
)

# --- on the robot -----------------------------------------------------------------------------------------------------

FEED_READERS = gauge(
    "splitslam_edge_feed_readers",
    "Readers of the local pose feed",
    "0 where a planner should read: its log.",
)
CHECK_PROBLEMS = gauge(
    "splitslam_edge_check_problems",
    "What the robot file and the first seconds do not agree on",
    "The log names each; `splitslam check` on a recording.",
)
CHECK_ROTATION = gauge(
    "splitslam_edge_check_rotation_radians",
    "T_lidar_imu is off by this, by the motion; NaN: unknown",
    "Above 0.03: the mounting in the robot file.",
)
CHECK_TIME_OFFSET = gauge(
    "splitslam_edge_check_time_offset_seconds",
    "The IMU's stamps are off by this, by the motion; NaN: unknown",
    "Above 0.005: `imu.time_offset_ns`, time synchronisation.",
)

EDGE_METRICS = tuple(value for value in tuple(globals().values()) if isinstance(value, Metric))
