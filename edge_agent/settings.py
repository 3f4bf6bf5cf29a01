"""Settings of the edge's scan pipeline; defaults are LIO-SAM's where it has them."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field

from edge_agent.rate import RateSettings
from splitslam.codec import STEP_M
from splitslam.config import Model


class FeatureSettings(Model):
    """What becomes a corner or a surf."""

    corner_threshold_m2: float = Field(default=1.0, gt=0)
    surf_threshold_m2: float = Field(default=0.1, gt=0)
    corners_per_sector: int = Field(default=20, ge=1)
    sectors: int = Field(default=6, ge=1)
    surf_leaf_m: float = Field(default=0.4, gt=0)
    sparse_corners: int = Field(default=200, ge=0)
    sparse_surfs: int = Field(default=800, ge=0)
    without_imu: float = Field(default=3.0, ge=1, description="times as many where no IMU says how the robot moves")


class DenseSettings(Model):
    """When a frame carries all its features, so that the map service can make a keyframe of it."""

    first_frames: int = Field(default=3, ge=1)
    distance_m: float = Field(default=1.0, ge=0)
    angle_rad: float = Field(default=0.2, ge=0)


class CarriedSettings(Model):
    """How far the motion alone may carry the pose, frame after frame, by its own account."""

    translation_m: float = Field(default=0.02, ge=0, description="1 sigma")
    rotation_rad: float = Field(default=0.003, ge=0, description="1 sigma")
    frames: int = Field(default=9, ge=0, description="in a row")


class PipelineSettings(Model):
    """Image and Feature node."""

    deskew: Literal["auto", "reference", "cpu", "fpga", "cosim", "off", "rotation"] = "auto"
    bitstream: Path | None = Field(default=None, description="the overlay's .bit, its .hwh beside it")
    min_points: int = Field(default=100, ge=1)
    step_m: float = Field(default=STEP_M, gt=1e-4, le=0.5)
    features: FeatureSettings = FeatureSettings()
    dense: DenseSettings = DenseSettings()
    rate: RateSettings = RateSettings()
    carried: CarriedSettings = CarriedSettings()
