"""Settings of the Imu node."""

from __future__ import annotations

from splitslam.config import Model


class ImuSettings(Model):
    """Defaults follow LIO-SAM where it has them; the noise figures are the robot file's, raised to what is seen.

    drift_mps2: acceleration that tilt and bias leave over when the IMU alone is integrated, and drift_s for how long
    it stays the same. gap_*: how a robot may turn and accelerate while the
    IMU is silent, and for how long the same way.
    """

    prior_bias_accel_mps2: float = 0.1
    prior_bias_gyro_radps: float = 0.01
    prior_velocity_mps: float = 10.0
    least_tilt_sigma_rad: float = 0.002
    lidar_rotation_rad: float = 0.001
    lidar_translation_m: float = 0.004
    unobserved_m: float = 10.0
    drift_rotation_rad_rts: float = 5e-4
    drift_translation_m_rts: float = 0.005
    max_velocity_mps: float = 80.0
    max_bias_accel_mps2: float = 2.0
    max_bias_gyro_radps: float = 1.0
    blend_time_s: float = 0.3
    blend_max_mps: float = 0.1
    blend_max_radps: float = 0.05
    blend_step_m: float = 0.01
    blend_step_rad: float = 0.003
    history_s: float = 10.0
    gap_radps: float = 0.5
    gap_mps2: float = 5.0
    gap_alike_s: float = 0.3
    drift_mps2: float = 0.03
    drift_s: float = 5.0
    no_imu_velocity_mps: float = 0.5
    no_imu_rate_radps: float = 0.5
