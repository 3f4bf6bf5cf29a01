"""The perturbations by name: what `--perturb` takes, a middle setting of all, and one at a time for a sweep."""

from __future__ import annotations

from dataclasses import dataclass, replace

from splitslam.errors import InputError
from splitslam.sim.spec import Perturbations


@dataclass(frozen=True)
class Fault:
    """One switch of `Perturbations`: its field, unit, strengths of a sweep, and its strength in ALL_MIDDLE (0: not)."""

    field: str
    unit: str
    strengths: tuple[float, ...]
    middle: float
    what: str


FAULTS: dict[str, Fault] = {
    "people": Fault("walking_people", "people", (3, 6), 4, "people walking to and fro"),
    "laser-bias": Fault("laser_bias_m", "m", (0.005, 0.01, 0.02), 0.01, "constant range error of each laser, std"),
    "incidence-bias": Fault("incidence_bias_m", "m", (0.01, 0.02, 0.05), 0.02, "range error at grazing incidence"),
    "mixed-pixels": Fault("mixed_pixels_mrad", "mrad", (1.5, 3.0), 3.0, "width of the beam, which edges split"),
    "glass": Fault("glass", "share", (0.5, 1.0), 1.0, "clean panes: beams go through or are mirrored"),
    "imu-offset": Fault("imu_time_offset_s", "s", (0.002, 0.01, 0.02), 0.01, "IMU stamps late"),
    "imu-jitter": Fault("imu_time_jitter_s", "s", (0.001, 0.003), 0.001, "IMU stamps late at random, std"),
    "imu-scale": Fault("imu_scale", "share", (0.003, 0.01), 0.003, "scale error of each IMU axis, std"),
    "imu-misalignment": Fault("imu_misalignment_deg", "deg", (0.3, 1.0), 0.3, "IMU axes not square, std"),
    "imu-vibration": Fault("imu_vibration_mps2", "m/s2", (1.0, 3.0, 10.0), 3.0, "37 Hz shake while moving, amplitude"),
    "imu-rate": Fault("imu_rate_hz", "Hz", (200.0, 100.0, 50.0), 100.0, "rate of the IMU; the robot file knows it"),
    "imu-mounting": Fault("imu_random_mounting", "0 or 1", (1,), 1, "IMU turned at random; the robot file knows it"),
    "extrinsic": Fault("extrinsic_error_deg", "deg", (0.5, 1.0, 2.0), 1.0, "rotation of T_lidar_imu misstated"),
    "gnss-jump": Fault("gnss_jump_m", "m", (15.0,), 15.0, "the fix stands aside for 6 s, from 20 s on"),
    "imu-dropout": Fault("imu_dropout_s", "s", (0.3, 1.0), 0.0, "no IMU samples for so long, from 20 s on"),
    "scans-lost": Fault("scans_lost", "share", (0.05, 0.2), 0.0, "scans missing from the recording, at random"),
    "blocked": Fault("blocked_deg", "deg", (90.0, 180.0), 0.0, "sector behind the sensor without returns"),
    "wheel-slip": Fault("wheel_slip", "share", (0.2, 0.6), 0.0, "wheels spin or drag, 1.5 s in every 10 s"),
    "kidnap": Fault("kidnap_m", "m", (5.0,), 0.0, "put so far back at 20 s and 35 s, blind for that scan"),
}


def perturbed(**strengths: float) -> Perturbations:
    """Perturbations with fields of these values; counts become whole numbers."""
    kinds = Perturbations()
    return replace(kinds, **{field: type(getattr(kinds, field))(value) for field, value in strengths.items()})


ALL_MIDDLE = perturbed(**{fault.field: fault.middle for fault in FAULTS.values() if fault.middle})
SWEEP: dict[str, Perturbations] = {
    f"{name}={strength:g}": perturbed(**{fault.field: strength})
    for name, fault in FAULTS.items()
    for strength in fault.strengths
}


def parse(text: str) -> Perturbations:
    """`none`, `middle`, or NAME[=STRENGTH],... -> perturbations; a bare name has the first strength of its sweep.

    `middle,NAME=0` is the middle setting without one. Raises InputError for what is not known or not a number.
    """
    result = Perturbations()
    for part in filter(None, (part.strip() for part in text.split(","))):
        name, equals, value = part.partition("=")
        if part in ("none", "middle"):
            result = ALL_MIDDLE if part == "middle" else Perturbations()
            continue
        if name not in FAULTS:
            raise InputError(f"--perturb: {name!r} is not known: expected none, middle or {', '.join(FAULTS)}")
        result = replace(result, **{FAULTS[name].field: _strength(name, value if equals else None)})
    return result


def _strength(name: str, text: str | None) -> float | int:
    fault = FAULTS[name]
    kind = type(getattr(Perturbations(), fault.field))
    if text is None:
        return kind(fault.strengths[0])
    try:
        value = kind(text)
    except ValueError:
        value = -1
    if not 0 <= value < float("inf"):
        raise InputError(f"--perturb: {name}={text}: expected a number of {fault.unit}, at least 0")
    return value
