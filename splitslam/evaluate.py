"""How far an estimated trajectory is from the truth: ATE and RPE as evaluation tools commonly define them.

Formulas: Sturm et al., "A benchmark for the evaluation of RGB-D SLAM systems", 2012, section IV.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from splitslam import se3
from splitslam.alignment import aligned, interpolate
from splitslam.errors import InputError
from splitslam.tum import Trajectory, read_tum

Array = NDArray[np.float64]
_RPE_NS = 1_000_000_000
_RPE_M = 10.0


class NoOverlapError(InputError):
    """Estimate and truth have no time in common."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Errors of an estimate, m.

    n: poses scored; outside: poses before or after the truth, not scored. ate_m, max_m: RMSE and largest position
    error after SE(3) alignment. rpe_1s_m, rpe_10m_m: RMSE of the relative translation over 1 s and over 10 m of
    truth path; None when the run is shorter. end_m: last position error after aligning the first pose.
    """

    n: int
    outside: int
    ate_m: float
    max_m: float
    rpe_1s_m: float | None
    rpe_10m_m: float | None
    end_m: float


def evaluate(estimate: Trajectory, truth: Trajectory) -> Evaluation:
    """Score `estimate` against `truth`, interpolated at the estimate's stamps.

    Raises NoOverlapError (an InputError) when no pose of the estimate lies in the truth's time span.
    """
    scored = estimate[inside(estimate, truth)]
    if not len(scored):
        raise NoOverlapError(
            f"stamp_s: expected poses in the truth's time span {_span(truth)}, the estimate covers {_span(estimate)}"
        )
    reference = interpolate(truth, scored.stamps_ns)
    error_m = np.linalg.norm(aligned(scored, reference) - reference.positions_m, axis=1)
    path_m = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth.positions_m, axis=0), axis=1))])
    at_m = np.interp(*_seconds_after(scored.stamps_ns, truth.stamps_ns), path_m)
    end = se3.inv(_pose(reference, 0)) @ _pose(reference, -1), se3.inv(_pose(scored, 0)) @ _pose(scored, -1)
    return Evaluation(
        n=len(scored),
        outside=len(estimate) - len(scored),
        ate_m=_rms(error_m),
        max_m=float(error_m.max()),
        rpe_1s_m=_rpe_m(scored, reference, np.searchsorted(scored.stamps_ns, scored.stamps_ns + _RPE_NS)),
        rpe_10m_m=_rpe_m(scored, reference, np.searchsorted(at_m, at_m + _RPE_M)),
        end_m=float(np.linalg.norm(end[0][:3, 3] - end[1][:3, 3])),
    )


def evaluate_files(estimate: Path, truth: Path) -> Evaluation:
    """Score the TUM file `estimate` against the TUM file `truth`. Raises InputError that names the file."""
    try:
        return evaluate(read_tum(estimate), read_tum(truth))
    except NoOverlapError as error:
        raise InputError(f"{estimate}: {error} ({truth})") from None


def as_dict(result: Evaluation) -> dict[str, float | int | None]:
    """The record's names and values."""
    return asdict(result)


def as_json(result: Evaluation) -> str:
    """One JSON object with the record's own names."""
    return json.dumps(as_dict(result), allow_nan=False)


def show(result: Evaluation) -> None:
    """A small table on stdout."""
    from rich.console import Console
    from rich.table import Table

    table = Table("error", "m", title=f"{result.n} poses scored, {result.outside} outside the truth")
    rows = {
        "ATE (RMSE after alignment)": result.ate_m,
        "largest after alignment": result.max_m,
        "RPE over 1 s": result.rpe_1s_m,
        "RPE over 10 m": result.rpe_10m_m,
        "end, first pose aligned": result.end_m,
    }
    for name, value_m in rows.items():
        table.add_row(name, "run too short" if value_m is None else f"{value_m:.4f}")
    table.columns[1].justify = "right"
    Console().print(table)


def inside(estimate: Trajectory, truth: Trajectory) -> NDArray[np.bool_]:
    """(N,) bool: which poses of the estimate lie in the truth's time span."""
    return (estimate.stamps_ns >= truth.stamps_ns[0]) & (estimate.stamps_ns <= truth.stamps_ns[-1])


def _rpe_m(estimate: Trajectory, reference: Trajectory, partner: NDArray[np.intp]) -> float | None:
    """RMSE of the translation of inv(inv(G_i) G_j) inv(T_i) T_j, j = partner[i]; i without a partner are left out.

    Its norm is that of R_Ti^T (p_Tj - p_Ti) - R_Gi^T (p_Gj - p_Gi): inv(inv(G_i) G_j) only turns the difference.
    """
    i = np.flatnonzero(partner < len(estimate))
    if not len(i):
        return None
    j = partner[i]
    steps = [_rotate_back(t.quats_xyzw[i], t.positions_m[j] - t.positions_m[i]) for t in (estimate, reference)]
    return _rms(np.linalg.norm(steps[0] - steps[1], axis=1))


def _rotate_back(quats_xyzw: Array, vectors: Array) -> Array:
    """R(q)^T v for each row: v + 2 u x (u x v + w v) with u = -q_xyz."""
    u, w = -quats_xyzw[:, :3], quats_xyzw[:, 3:]
    return vectors + 2.0 * np.cross(u, np.cross(u, vectors) + w * vectors)


def _pose(trajectory: Trajectory, row: int) -> Array:
    return se3.from_quat(trajectory.positions_m[row], trajectory.quats_xyzw[row])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _seconds_after(stamps_ns: NDArray[np.int64], origin_ns: NDArray[np.int64]) -> tuple[Array, Array]:
    """Both in seconds after the first of `origin_ns`: an epoch in float64 seconds would lose the nanoseconds."""
    return (stamps_ns - origin_ns[0]) * 1e-9, (origin_ns - origin_ns[0]) * 1e-9


def _span(trajectory: Trajectory) -> str:
    return " to ".join(f"{int(trajectory.stamps_ns[row]) / 1e9:.3f} s" for row in (0, -1))
