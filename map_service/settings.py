"""Settings of the map pipeline; every default is the one the published figures were measured with."""

from __future__ import annotations

from pydantic import Field

from splitslam.config import Model
from splitslam.registration.settings import LocalMapSettings, RegistrationSettings


class WideSearchSettings(Model):
    """The search for the place of a scan around where it was expected."""

    radius_m: float = 12.0
    step_m: float = 1.0
    yaw_step_rad: float = Field(default=0.09, description="all the way round")
    coarse_corners: int = 150
    coarse_surfs: int = 40
    coarse_gate_m: float = 1.0
    fine_gate_m: float = 0.4
    starts: int = 24
    start_apart_m: float = 1.1
    start_apart_rad: float = 0.1
    rough_points: int = 200
    rough_sigma_m: float = Field(
        default=0.15, description="points count as so inexact at first, which widens the basin"
    )
    finalists: int = 5
    softenings: int = 3
    fine_points: int = 1000
    tilt_rad: float = 0.05
    reach_m: float = Field(default=0.3, description="half of what registration's gate is wider than in tracking")
    apart_m: float = Field(default=0.7, description="nearer than this it is the same place")


class DoubtSettings(Model):
    """When a pose is doubted, given up and found again; scores are shares of what this session's scans usually have."""

    level_gain: float = 0.1
    learn_scans: int = 10
    lookout_scans: int = Field(default=3, description="least, for a robot that is looked for: it has nothing better")
    doubt_share: float = Field(default=0.75, description="below it other places are looked at")
    refuse_share: float = Field(default=0.5, description="below it the edge's motion carries the pose")
    patience_scans: int = Field(default=2, description="refused so often and once more, the robot is lost")
    found_share: float = Field(default=0.6, description="least score of a place that comes into question")
    clear_ratio: float = Field(default=1.3, description="by which a place must beat all others")
    apart_m: float = Field(default=0.7, description="nearer than this it is the same place")
    confirm_scans: int = 3
    hypotheses: int = Field(default=4, description="places that are followed at a time")
    ambiguous_scans: int = Field(default=10, description="so long two places must fit to be alike")
    search_scans: int = Field(
        default=3, description="from the first search to the second; each wait is longer by so many"
    )
    search_limit_scans: int = 15
    kidnap_m: float = Field(default=5.0, description="sigma of a pose that is not believed")
    kidnap_rad: float = 1.0


class TrackerSettings(Model):
    """Scan-to-map tracking and keyframes."""

    local_map: LocalMapSettings = LocalMapSettings()
    registration: RegistrationSettings = RegistrationSettings()
    doubt: DoubtSettings = DoubtSettings()
    search: WideSearchSettings = WideSearchSettings()
    keyframe_m: float = 0.9
    keyframe_rad: float = 0.18
    pose_rotation_rad: float = 0.0005
    pose_translation_m: float = 0.005
    start_acceleration_mps2: float = 5.0
    start_rotation_radps2: float = 5.0
    bootstrap_iterations: int = 4
    twist_spread_gain: float = Field(default=0.5, description="of the newest change in the mean of what a twist does")
    unseen_m: float = Field(default=2.0, description="1 sigma of a motion after which a scan is looked for all around")
    carried_m: float = Field(default=0.1, description="1 sigma that frames without points may add up to in tracking")
    min_inliers: int = 60
    min_inlier_share: float = 0.15
    lost_frames: int = 10


class GroundSettings(Model):
    """When a keyframe of before stands for the ground that the robot is on."""

    reach_m: float = Field(default=0.9, description="no further than keyframes are apart")
    turn_rad: float = Field(default=0.5, description="a sensor may not see all around it")
    min_age_s: float = Field(default=30.0, description="younger ones are of this visit")
    tied_m: float = Field(default=20.0, description="way in the graph to where the robot is")
    usual_share: float = Field(
        default=0.85, description="of the usual fit: where a scan fits worse things have changed"
    )


class GraphSettings(Model):
    """The factor graph."""

    relinearise_threshold: float = 0.01
    relinearise_enu_rad: float = 0.003
    extra_updates: int = 3
    first_tilt_rad: tuple[float, float] = Field(default=(0.002, 0.1), description="least and most doubt of the start")
    enu_tilt_rad_per_m: float = Field(default=0.3, description="doubt of T_enu_map's tilt by the noise of altitudes")
    odometry_rotation_rad: float = 5e-4
    odometry_translation_m: float = 0.003
    odometry_translation_share: float = 0.002
    kidnap_rad: float = Field(default=0.03, description="doubt of the joint after the robot was lost and found")
    kidnap_m: float = 0.3
    rebuild_m: float = 0.02
    rebuild_rad: float = 0.005
    rebuild_points: int = Field(default=100_000, description="that go into a map that is made anew after one scan")
    report_m: float = 0.001
    report_rad: float = 0.0002
    version_m: float = Field(default=0.01, gt=0, description="so far a keyframe moves until the map has a new version")
    version_rad: float = Field(default=0.002, gt=0, description="the same for its rotation")


class LevelSettings(Model):
    """When the map is turned to be level."""

    keyframes: int = Field(default=10, description="that must have been seen")
    window: int = Field(default=150, description="keyframes that count, older ones less")
    fade: float = Field(default=50.0, description="keyframes after which one counts for 1/e")
    alike: float = Field(default=10.0, description="so many neighbours have the same error of gravity")
    mounting_rad: float = Field(default=0.01, description="how well T_lidar_imu is believed")
    tolerable_rad: float = 0.035
    stood_rad: float = Field(default=0.05, description="gravity at the first frame is surer than this: the robot stood")
    stood_prior_rad: float = 0.002
    stood_tolerable_rad: float = Field(default=0.1, description="nothing on the move is as sure as gravity at rest")
    drift_rad_per_m: float = Field(default=5e-5, description="how the map's tilt drifts with the odometry")
    near_rad: float = Field(default=0.005, description="the same while levelling moves nothing by more than a step")
    sigmas: float = 2.5
    until_share: float = Field(default=0.3, description="of what is tolerable: where levelling ends")
    step_rad: float = 0.002
    young_m: float = Field(default=30.0, description="a map of no more than this is levelled in larger steps")
    young_step_m: float = 0.3
    step_m: float = Field(default=0.03, description="a step moves the robot by so much at least, near the origin")


class GnssSettings(Model):
    """Which fixes become factors, and how strongly."""

    floor_m: float = Field(default=0.02, description="antenna and time stamps are not known better than this")
    unknown_sigma_m: float = Field(default=3.0, description="horizontal, when the receiver does not say")
    max_sigma_m: float = 5.0
    gate_sigmas: float = 3.0
    drift_share: float = Field(default=0.005, description="deviation of the odometry's drift, share of the way")
    majority: float = Field(default=0.6, description="share of the fixes before it that a fix must agree with")
    keep: int = Field(default=32, description="fixes of a datum that new ones are compared with")
    spacing_m: float = Field(default=5.0, description="between fixes that become factors")
    trust_m: float = Field(default=30.0, description="way after which one fix alone does not continue a datum")
    confirm_s: float = Field(default=8.0, description="how long fixes must agree before they continue it")
    start_spacing_m: float = 1.0
    start_distance_m: float = 5.0
    start_sigmas: float = 5.0
    start_fixes: int = 4
    renew_s: float = Field(default=10.0, description="how long fixes must agree before they replace a datum")
    widen_s: float = Field(default=60.0, description="how long none must agree before more drift is believed")
    max_waiting: int = 64
    max_data: int = 8
    path_step_m: float = 0.5
    correlation_s: float = Field(default=30.0, description="how long errors of code-phase fixes last")
    correlated_sigma_m: float = Field(default=0.5, description="smaller errors last shorter, in proportion")
    robust_sigmas: float = 3.0


class PlaceSettings(Model):
    """The place descriptor and its look-up."""

    rings: int = 20
    sectors: int = 60
    reach_m: float = 40.0
    floor_m: float = Field(default=-2.0, description="heights count from here, relative to the sensor")
    ceiling_m: float = 8.0
    key_frequencies: int = 5
    shortlist: int = 16
    lane_m: float = Field(default=2.0, description="a place is also looked for from this far beside the way")
    keyframes: int = Field(default=3, description="a place is a keyframe and this many on either side")
    points: int = 6000


class LoopFitSettings(Model):
    """How a loop candidate's clouds are laid on each other, and what counts as lying there."""

    voxel_m: float = 0.25
    neighbours: int = 12
    min_points: int = 100
    coarse_distance_m: float = 3.0
    fine_distance_m: float = 0.75
    inlier_m: float = 0.3
    sight_m: float = 8.0
    sigma_m: float = 0.02
    correlation: float = 8.0
    weak_share: float = Field(default=0.03, description="information that noisy normals feign, relative to the largest")
    open_sigma_m: float = 10.0
    rival_m: float = 1.5
    rival_rad: float = 0.5
    rival_reach_m: float = 12.0
    rival_step_m: float = 0.5
    rival_points: int = 500
    rival_rough_share: float = 0.7
    rivals: int = 4


class LoopGateSettings(Model):
    """Which loops may enter the graph."""

    drift_share: float = Field(default=0.01, description="drift of the odometry that surprises nobody")
    drift_floor_m: float = 0.3
    turn_per_m: float = Field(default=5e-4, description="the same for the heading, rad a metre")
    turn_floor_rad: float = 0.05
    extreme: float = Field(default=5.0, description="times that drift: what several loops together may correct")
    open_extreme: float = Field(default=0.5, description="the same for a fit that leaves a direction open")
    support: int = Field(default=3, description="loops that must agree before they correct more than the usual drift")
    span_m: float = Field(default=12.0, description="and the way over which they must come")
    quiet_m: float = Field(default=30.0, description="with no place on it or so shortly before it that repeats itself")
    pair_floor_m: float = 0.3
    pair_floor_rad: float = 0.03
    pair_share: float = Field(default=0.05, description="drift between two loops that may still agree")
    pair_turn_per_m: float = Field(default=2e-3, description="the same for the heading, rad a metre")
    apart_m: float = Field(default=2.0, description="loops at one place are no support for each other")
    forget_m: float = 100.0


class LoopSettings(Model):
    """Loop closures."""

    places: PlaceSettings = PlaceSettings()
    fit: LoopFitSettings = LoopFitSettings()
    gate: LoopGateSettings = LoopGateSettings()
    radius_m: float = 10.0
    min_age_s: float = 30.0
    spacing_m: float = 3.0
    apply_after_frames: int = 30
    target_keyframes: int = 10
    source_keyframes: int = 3
    min_inlier_share: float = 0.7
    min_backward_share: float = 0.4
    max_tilt_rad: float = 0.05
    rival_share: float = Field(default=0.85, description="another alignment that fits this well makes a fit ambiguous")
    rotation_sigma_rad: float = 0.003
    translation_sigma_m: float = 0.02
    likeness: float = Field(default=0.55, description="of two places, -1 to 1, above which they are compared closely")
    strong_likeness: float = 0.7
    patience_m: float = Field(default=24.0, description="way to the next look after failures in a row, at most")
    strong_patience_m: float = Field(default=9.0, description="the same for places above the strong likeness")
    near_way_m: float = Field(default=20.0, description="places tied by a shorter way in the graph need no loop")
    near_drift_m: float = Field(default=1.5, description="usual drift up to which the graph's guess does for GICP")
    search_voxel_share: float = 0.06
    search_voxel_min_m: float = 0.3
    search_voxel_max_m: float = 0.75
    search_inlier_m: float = 1.0
    search_inlier_share: float = 0.6


class PipelineSettings(Model):
    """One session's map pipeline."""

    tracker: TrackerSettings = TrackerSettings()
    graph: GraphSettings = GraphSettings()
    ground: GroundSettings = GroundSettings()
    gnss: GnssSettings = GnssSettings()
    level: LevelSettings = LevelSettings()
    loops: LoopSettings = LoopSettings()
    doubt: float = Field(default=1.5, description="variance of a registration's error by its own account, from NEES")
    commit_frames: int = 20
    commit_s: float = 1.0
