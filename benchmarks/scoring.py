"""A system's trajectory against the truth: the stamp offset that suits it best, its errors, what it missed.

Systems stamp poses differently: with the scan's start, middle or end, or with the scan after the one they are of. That
is a convention and no error, so each peer is judged at the constant offset that gives it the smallest ATE.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from splitslam.evaluate import evaluate, inside
from splitslam.tum import Trajectory

MS = 1_000_000
SEARCH_NS = 300 * MS
_COARSE_NS, _FINE_NS = 20 * MS, 2 * MS
_DENSE_NS = 10 * MS
# A trajectory has diverged when it is this far off somewhere: no drift of a healthy odometry, on any drive here.
DIVERGED_M, DIVERGED_PATH_RATIO = 1.0, 0.05
# Scans may lack a pose while a system starts up, and a few later; with more, it has failed.
MISSING_RATIO = 0.10


@dataclass(frozen=True, slots=True)
class Score:
    """How well a trajectory fits. Errors in m as in splitslam.evaluate; None: nothing to score, or too short.

    scans: scans of the recording that the truth covers; missing: those of them without a pose. offset_ns: added to the
    stamps before scoring. diverged: somewhere further off than a drifting odometry would be. failed: diverged, or more
    than a tenth of the poses is missing, or not a number.
    """

    scans: int
    missing: int
    offset_ns: int = 0
    ate_m: float | None = None
    rpe_1s_m: float | None = None
    max_m: float | None = None
    diverged: bool = False

    @property
    def failed(self) -> bool:
        """True when the figures do not stand for a working system."""
        return self.ate_m is None or self.diverged or self.missing > MISSING_RATIO * self.scans

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {**asdict(self), "failed": self.failed}


def score(estimate: Trajectory | None, truth: Trajectory, scan_stamps_ns: NDArray[np.int64], *, search: bool) -> Score:
    """Scores `estimate` (None: there is none) against `truth`, made dense first.

    scan_stamps_ns: (N,) int64, the recording's scans, each of which should have a pose with its stamp. search: whether
    the stamp offset is searched; a system that follows our conventions is scored as it is.
    """
    covered = scan_stamps_ns[(scan_stamps_ns >= truth.stamps_ns[0]) & (scan_stamps_ns <= truth.stamps_ns[-1])]
    estimate = None if estimate is None else finite(estimate)
    there = np.isin(covered, estimate.stamps_ns) if estimate is not None else np.zeros(len(covered), bool)
    nothing = Score(scans=len(covered), missing=int(np.count_nonzero(~there)))
    if estimate is None or len(estimate) < 3 or not inside(estimate, truth).any():
        return nothing
    truth = dense(truth)
    offset_ns = best_offset_ns(estimate, truth) if search else 0
    errors = evaluate(shifted(estimate, offset_ns), truth)
    limit_m = max(DIVERGED_M, DIVERGED_PATH_RATIO * truth.path_m)
    return replace(
        nothing,
        offset_ns=offset_ns,
        ate_m=errors.ate_m,
        rpe_1s_m=errors.rpe_1s_m,
        max_m=errors.max_m,
        diverged=bool(errors.max_m > limit_m),
    )


def best_offset_ns(estimate: Trajectory, truth: Trajectory) -> int:
    """The constant that, added to the estimate's stamps, gives the smallest ATE: 20 ms steps, then 2 ms ones."""
    coarse = _best(estimate, truth, np.arange(-SEARCH_NS, SEARCH_NS + 1, _COARSE_NS))
    return _best(estimate, truth, coarse + np.arange(-_COARSE_NS, _COARSE_NS + 1, _FINE_NS))


def _best(estimate: Trajectory, truth: Trajectory, offsets_ns: NDArray[np.int64]) -> int:
    errors = [evaluate(shifted(estimate, int(offset)), truth).ate_m for offset in offsets_ns]
    return int(offsets_ns[int(np.argmin(errors))])


def shifted(trajectory: Trajectory, offset_ns: int) -> Trajectory:
    """The same poses, stamped `offset_ns` later."""
    return replace(trajectory, stamps_ns=trajectory.stamps_ns + offset_ns)


def finite(trajectory: Trajectory) -> Trajectory:
    """Without poses that are not numbers, and of poses with the same stamp the last."""
    values = np.hstack([trajectory.positions_m, trajectory.quats_xyzw])
    keep = np.isfinite(values).all(axis=1) & np.append(np.diff(trajectory.stamps_ns) > 0, True)
    return trajectory[np.asarray(keep)]


def dense(truth: Trajectory) -> Trajectory:
    """The truth every 10 ms: cubic splines of position and attitude through its poses.

    Between poses 0.1 s apart a straight line is some millimetres off a walker's head, which would be held against
    exactly those whose stamps lie there.
    """
    if len(truth) < 4 or np.median(np.diff(truth.stamps_ns)) <= _DENSE_NS:
        return truth
    at_s = (truth.stamps_ns - truth.stamps_ns[0]) * 1e-9
    steps_ns = np.arange(0, truth.stamps_ns[-1] - truth.stamps_ns[0], _DENSE_NS)
    stamps_ns = np.union1d(truth.stamps_ns[0] + steps_ns, truth.stamps_ns)
    fine_s = (stamps_ns - truth.stamps_ns[0]) * 1e-9
    attitude = RotationSpline(at_s, Rotation.from_quat(truth.quats_xyzw))
    return Trajectory(stamps_ns, CubicSpline(at_s, truth.positions_m)(fine_s), attitude(fine_s).as_quat())
