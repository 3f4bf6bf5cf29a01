"""Wheel kernels: what the wheels say against the integrated IMU, and the velocity that follows from both.

state row (15,): R_odom_imu row-major (9), position (3), velocity (3). geometry (3, 4): R_wheel_imu, and the wheel
frame's origin in `imu`. reading row (10,): time s, speed along x y z of `wheel` (3), its variance as it is gated with
(3), and as it is fused with (3); a variance below zero: that axis is not measured.
"""

from __future__ import annotations

import numpy as np
from numba import njit

FASTMATH = {"contract", "arcp", "nsz"}
_GATE = 9.0  # three sigma, one axis


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def speed(state, change, rate, geometry, out):
    """out (3,): velocity of the wheel frame's origin, in `wheel`, of a state as it was change[0] s before.

    change (4,): that time and the acceleration, odom, m/s^2. rate (3,): of `imu`, rad/s.
    """
    body, turned = np.empty(3), np.empty(3)
    for c in range(3):
        body[c] = 0.0
        for r in range(3):
            body[c] += state[3 * r + c] * (state[12 + r] - change[1 + r] * change[0])
    for c in range(3):
        i, j = (c + 1) % 3, (c + 2) % 3
        turned[c] = body[c] + change[0] * (rate[i] * body[j] - rate[j] * body[i])
        turned[c] += rate[i] * geometry[j, 3] - rate[j] * geometry[i, 3]
    for a in range(3):
        out[a] = geometry[a, 0] * turned[0] + geometry[a, 1] * turned[1] + geometry[a, 2] * turned[2]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def innovations(times_s, rates, states, readings, geometry, out):
    """out (W, 3): readings (W, 10) minus what the states (M, 15) at times_s (M,) say at the readings' own times."""
    change, here = np.zeros(4), np.empty(3)
    k = 0
    for j in range(len(readings)):
        while k < len(times_s) - 1 and times_s[k] < readings[j, 0]:
            k += 1
        _before(times_s, states, k, readings[j, 0], change)
        speed(states[k], change, rates[k], geometry, here)
        for a in range(3):
            out[j, a] = readings[j, 1 + a] - here[a]


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def _before(times_s, states, k, time_s, change):
    """change (4,) for `speed`: from state k back to time_s."""
    change[0] = times_s[k] - time_s
    dt = times_s[k] - times_s[k - 1] if k > 0 else 0.0
    for r in range(3):
        change[1 + r] = (states[k, 12 + r] - states[k - 1, 12 + r]) / dt if dt > 0.0 else 0.0


@njit(cache=True, nogil=True, fastmath=FASTMATH)
def aid(times_s, rates, states, readings, geometry, noise, P):
    """A Kalman filter on the velocity alone: states (M, 15), integrated without wheels, are corrected in place.

    Given the rotation the motion is linear: a correction of the velocity at one time adds to all that follows.
    P (3, 3): covariance of the velocity, odom, at times_s[0]; becomes that at the end. noise (4,): accelerometer's
    white noise squared; square of the acceleration that tilt and bias leave over; for how long that may add up, s; time
    since the last optimised state, s. A reading that contradicts both is left out, axis by axis.
    """
    dv, dp, change, here, H, PH = np.zeros(3), np.zeros(3), np.zeros(4), np.empty(3), np.empty(3), np.empty(3)
    raw = np.empty(3)  # velocity before this state's corrections: differences of it are accelerations
    raw_last = np.zeros(3)
    j = 0
    for k in range(len(times_s)):
        dt = times_s[k] - times_s[k - 1] if k > 0 else 0.0
        age_s = noise[3] + times_s[k] - times_s[0]
        for r in range(3):
            raw[r] = states[k, 12 + r]
            dp[r] += dv[r] * dt
            states[k, 9 + r] += dp[r]
            states[k, 12 + r] += dv[r]
            # an acceleration that is off by sigma takes the velocity off by sigma t: variance grows with 2 sigma^2 t
            P[r, r] += (noise[0] + 2.0 * noise[1] * min(age_s, noise[2])) * dt
            change[1 + r] = (raw[r] - raw_last[r]) / dt if dt > 0.0 else 0.0
            raw_last[r] = raw[r]
        while j < len(readings) and readings[j, 0] <= times_s[k]:
            change[0] = times_s[k] - readings[j, 0]
            for a in range(3):
                if readings[j, 7 + a] < 0.0:
                    continue
                speed(states[k], change, rates[k], geometry, here)
                for r in range(3):
                    H[r] = 0.0
                    for c in range(3):
                        H[r] += geometry[a, c] * states[k, 3 * r + c]
                variance = 0.0
                for r in range(3):
                    PH[r] = P[r, 0] * H[0] + P[r, 1] * H[1] + P[r, 2] * H[2]
                    variance += H[r] * PH[r]
                innovation = readings[j, 1 + a] - here[a]
                if innovation * innovation > _GATE * (variance + readings[j, 4 + a]):
                    continue
                total = variance + readings[j, 7 + a]
                for r in range(3):
                    dv[r] += PH[r] * innovation / total
                    states[k, 12 + r] += PH[r] * innovation / total
                for r in range(3):
                    for c in range(3):
                        P[r, c] -= PH[r] * PH[c] / total
            j += 1
