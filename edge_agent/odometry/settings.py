"""Settings of the edge's own LiDAR odometry."""

from __future__ import annotations

from pydantic import Field

from splitslam.config import Model
from splitslam.registration.settings import LocalMapSettings, RegistrationSettings


class OdometrySettings(Model):
    """When it runs, and how; registration, gates and doubts are the map service's."""

    enabled: bool = True
    after_s: float = Field(default=0.5, gt=0, description="a scan unanswered for so long: the robot goes on alone")
    first_after_s: float = Field(default=2.0, gt=0, description="likewise, before the first answer of all")
    unanswered: int = Field(default=4, ge=2, description="scans that must be unanswered besides")
    back_s: float = Field(default=0.3, gt=0, description="an answer to a scan no older than this: it is not alone")
    lost_answers: int = Field(
        default=5, ge=1, description="in a row that look for a robot that was known: it goes on alone meanwhile"
    )
    late_s: float = Field(default=3.0, gt=0, description="answers up to this age still say where `map` is")
    late_gain: float = Field(default=0.1, gt=0, le=1, description="weight of each of them after the first few")
    keyframes: int = Field(default=80, ge=2, description="dense scans that are kept to match against")
    keyframe_s: float = Field(default=0.15, ge=0, description="between two of them")
    keyframe_points: int = Field(default=2500, ge=100, description="of a dense scan that are kept, at most")
    first_keyframes: int = Field(default=3, ge=1, description="in the map when an outage begins: the newest")
    more_keyframes: int = Field(default=1, ge=1, description="older ones that join them with each scan")
    points: int = Field(default=1500, ge=100, description="of a scan that are matched, at most")
    scans_at_once: int = Field(default=2, ge=2, description="placed with each new one, while some wait")
    local_map: LocalMapSettings = LocalMapSettings()
    registration: RegistrationSettings = RegistrationSettings()
    pose_rotation_rad: float = 0.0005
    pose_translation_m: float = 0.005
    min_inliers: int = 60
    min_inlier_share: float = 0.15
    failed_scans: int = Field(default=5, ge=1, description="in a row: then a dense one is kept where it was carried to")
    min_features: int = Field(default=200, ge=1, description="of that one")
    doubt: float = Field(default=1.5, description="variance of a registration's error by its own account")
