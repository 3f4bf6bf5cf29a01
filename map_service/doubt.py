"""Is the robot still where tracking has it? What is held against it, and what brings the trust back.

A scan that was taken elsewhere still registers: in a street most planes go on matching when it is put back by 5 m. What
gives it away is how well it fits, against how well the scans just before it did: on new ground, among people and in
quick turns the score goes down slowly, between two scans hardly by a tenth; elsewhere it falls at once by half.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from map_service.settings import DoubtSettings
from map_service.wide_search import Fit, Place, distance_m
from splitslam import se3

Array = NDArray[np.float64]


class Verdict(Enum):
    """Of one scan's fit. All but TRUSTED ask for a look around. If no other place is better, the pose stands with
    UNKNOWN (the first scans with so many features) and DOUBTED (the scan stays out of the map), not with REFUSED.
    """

    TRUSTED = 1
    UNKNOWN = 2
    DOUBTED = 3
    REFUSED = 4


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """Where a lost robot may be: T_local_lidar (4, 4), the score there, and how many scans in a row fitted."""

    T_local_lidar: Array
    score: float
    confirmed: int


@dataclass(slots=True, eq=False)
class DoubtState:
    """All that must survive a restart.

    levels: usual score of this session's scans and from how many it was learnt, by octave of their number of features:
    denser scans hold worse features. doubted: scans in a row. covariance (6, 6): of a pose that is carried and not
    believed, right tangent, rotation first; zero while it is. T_local_lost (4, 4): the last pose that was believed.
    ambiguous: places that are alike have been seen since. searches: so many since then, the next one in `wait` scans.
    changed: the world is not what the map says, and no keyframe has shown it how it is.
    """

    levels: dict[int, tuple[float, int]] = field(default_factory=dict)
    doubted: int = 0
    lost: bool = False
    covariance: Array = field(default_factory=lambda: np.zeros((6, 6)))
    T_local_lost: Array = field(default_factory=lambda: np.eye(4))
    hypotheses: list[Hypothesis] = field(default_factory=list)
    ambiguous: bool = False
    searches: int = 0
    wait: int = 0
    changed: bool = False


class Doubt:
    """Weighs scores and places; where to look and how to carry the pose is the tracker's."""

    def __init__(self, settings: DoubtSettings) -> None:
        self.settings = settings
        self.state = DoubtState()

    # --- tracking ---------------------------------------------------------------------------------------------

    def weigh(self, fit: Fit) -> Verdict:
        """Takes the fit of the next scan. The usual level is learnt from trusted scans alone."""
        s, d = self.settings, self.state
        level, scans = d.levels.get(fit.octave, (0.0, 0))
        usual = self._usual(fit, s.learn_scans)
        if usual is None or fit.score >= s.doubt_share * usual:
            self._learn(fit)
            d.doubted, d.covariance = 0, np.zeros((6, 6))
            return Verdict.TRUSTED
        if scans < s.learn_scans:
            self._learn(fit)
            return Verdict.UNKNOWN
        d.doubted += 1
        if fit.score < s.refuse_share * level:
            return Verdict.REFUSED
        if d.doubted > s.patience_scans:  # no place is better: this is what the world looks like now
            share, d.doubted, d.changed = fit.score / level, 0, True
            d.levels = {octave: (share * usual, n) for octave, (usual, n) in d.levels.items()}
        return Verdict.DOUBTED

    def learnt(self) -> None:
        """A keyframe has been made: the map has what the world looks like here."""
        self.state.changed = False

    def fits(self, fit: Fit) -> bool:
        """Is this about as well as scans fit where they were taken?"""
        usual = self._usual(fit, self.settings.lookout_scans)
        return usual is not None and fit.score >= self.settings.doubt_share * usual

    def as_usual(self, fit: Fit, share: float) -> bool:
        """Does a scan fit no worse than such a share of what is usual?"""
        usual = self._usual(fit, self.settings.learn_scans)
        return usual is not None and fit.score >= share * usual

    def can_tell(self, fit: Fit) -> bool:
        """Have there been scans enough to tell a place that fits from one that does not?"""
        return self._usual(fit, self.settings.lookout_scans) is not None

    def _usual(self, fit: Fit, scans: int) -> float | None:
        """The score that is usual for so many features, or for the nearest number known from as many scans; or None."""
        known = {octave: level for octave, (level, n) in self.state.levels.items() if n >= scans}
        return known[min(known, key=lambda octave: abs(octave - fit.octave))] if known else None

    def _learn(self, fit: Fit) -> None:
        level, scans = self.state.levels.get(fit.octave, (0.0, 0))
        gain = max(self.settings.level_gain, 1.0 / (scans + 1.0))
        self.state.levels[fit.octave] = level + gain * (fit.score - level), scans + 1

    def is_elsewhere(self, here: Place, places: list[Place]) -> bool:
        """Does the scan fit clearly better at another place, or has it been refused for too long?"""
        s, d = self.settings, self.state
        others = [p for p in places if distance_m(p.T_local_lidar, here.T_local_lidar) > s.apart_m]
        if any(p.fit.tells and self._in_question(p) and p.fit.score > s.clear_ratio * here.fit.score for p in others):
            return True
        return d.doubted > s.patience_scans

    def _in_question(self, place: Place) -> bool:
        usual = self._usual(place.fit, self.settings.lookout_scans)
        return usual is not None and place.fit.score > self.settings.found_share * usual

    # --- lost -------------------------------------------------------------------------------------------------

    def lose(self, T_local_lidar: Array) -> None:
        """From here on the pose is carried, and looked for; T_local_lidar (4, 4): the last that was believed."""
        d = self.state
        if not d.lost:
            d.lost, d.T_local_lost, d.hypotheses = True, T_local_lidar, []
            d.ambiguous, d.searches, d.wait = False, 0, 0

    def carry(self, T_prev_lidar: Array, motion_covariance: Array) -> Array:
        """(6, 6) of a pose that is not believed, after another motion (4, 4) with its covariance (6, 6)."""
        s, d = self.settings, self.state
        if not d.covariance.any():
            d.covariance = np.diag(np.repeat([s.kidnap_rad**2, s.kidnap_m**2], 3))
        back = se3.adjoint(se3.inv(T_prev_lidar))
        d.covariance = back @ d.covariance @ back.T + motion_covariance
        return d.covariance

    def next_centre(self, T_carried: Array) -> Array | None:
        """Where to search now, if it is time: in turn where the robot was lost and where it was carried since."""
        d = self.state
        d.wait -= 1
        return None if d.wait > 0 else (T_carried, d.T_local_lost)[d.searches % 2]

    def consider(self, places: list[Place], here: Place | None = None) -> None:
        """Takes the outcome of a search: all places that come into question are followed from now on.

        Of those where the scan would lie as well a bit further there is no end, so only `here`, which was not searched.
        """
        s, d = self.settings, self.state
        d.searches += 1
        d.wait = min(s.search_scans * d.searches, s.search_limit_scans)
        telling = [p for p in places if p.fit.tells]
        for p in filter(self._in_question, telling if here is None else [here, *telling]):
            if all(distance_m(p.T_local_lidar, h.T_local_lidar) > s.apart_m for h in d.hypotheses):
                d.hypotheses.append(Hypothesis(p.T_local_lidar, p.fit.score, 0))
        d.hypotheses = sorted(d.hypotheses, key=lambda h: -h.score)[: s.hypotheses]

    def confirm(self, outcomes: list[Place]) -> int | None:
        """Takes how the next scan fits at each hypothesis; the index of the one that is the robot's place, if clear.

        A place that has not fitted for some scans is dropped. Where two go on fitting neither is believed, nor when one
        is dropped later: it may be the true one, which has come to new ground, while the other follows old ground. A
        scan that would lie anywhere says nothing for or against one of several places.
        """
        s, d = self.settings, self.state
        several = len(outcomes) > 1
        for i, place in enumerate(outcomes):
            before = d.hypotheses[i].confirmed
            count = max(before, 0) + 1 if self.fits(place.fit) else min(before, 0) - 1
            if several and not place.fit.tells:
                count = before
            d.hypotheses[i] = Hypothesis(place.T_local_lidar, place.fit.score, count)
        d.ambiguous |= sum(h.confirmed >= s.ambiguous_scans for h in d.hypotheses) > 1
        alive = [i for i, h in enumerate(d.hypotheses) if h.confirmed > -s.confirm_scans]
        best = max(alive, key=lambda i: d.hypotheses[i].score, default=None)
        clear = (
            best is not None
            and not d.ambiguous
            and d.hypotheses[best].confirmed >= s.confirm_scans
            and (outcomes[best].fit.tells or not several)
            and all(d.hypotheses[best].score > s.clear_ratio * d.hypotheses[i].score for i in alive if i != best)
        )
        d.hypotheses = [d.hypotheses[i] for i in alive]
        return best if clear else None

    def found(self) -> None:
        """Trust is back."""
        self.state = DoubtState(self.state.levels)

    # --- the rest ---------------------------------------------------------------------------------------------

    def move(self, T_new_local: Array) -> None:
        """`local` is renamed, by T_new_local (4, 4)."""
        d = self.state
        d.T_local_lost = se3.orthonormalised(T_new_local @ d.T_local_lost)
        d.hypotheses = [
            Hypothesis(se3.orthonormalised(T_new_local @ h.T_local_lidar), h.score, h.confirmed) for h in d.hypotheses
        ]

    def dump(self) -> dict:
        """JSON-ready."""
        d = self.state
        return {
            "levels": [[octave, level, scans] for octave, (level, scans) in d.levels.items()],
            "doubted": d.doubted,
            "lost": d.lost,
            "covariance": d.covariance.tolist(),
            "T_local_lost": d.T_local_lost.tolist(),
            "hypotheses": [[h.T_local_lidar.tolist(), h.score, h.confirmed] for h in d.hypotheses],
            "ambiguous": d.ambiguous,
            "searches": d.searches,
            "wait": d.wait,
            "changed": d.changed,
        }

    def load(self, data: dict) -> None:
        """What `dump` gave."""
        self.state = DoubtState(
            {octave: (level, scans) for octave, level, scans in data["levels"]},
            data["doubted"],
            data["lost"],
            np.array(data["covariance"]),
            np.array(data["T_local_lost"]),
            [Hypothesis(np.array(T), score, confirmed) for T, score, confirmed in data["hypotheses"]],
            data["ambiguous"],
            data["searches"],
            data["wait"],
            data.get("changed", False),
        )
