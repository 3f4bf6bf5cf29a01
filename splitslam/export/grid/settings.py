"""What an occupancy grid is to be."""

from __future__ import annotations

from dataclasses import dataclass

from splitslam.errors import InputError


@dataclass(frozen=True, slots=True)
class GridSettings:
    """resolution_m: side of a cell. min_height_m, max_height_m: above the ground there, what stands in the way.

    range_m: how far from the sensor rays count.
    """

    resolution_m: float = 0.05
    min_height_m: float = 0.2
    max_height_m: float = 2.0
    range_m: float = 20.0

    def __post_init__(self) -> None:
        """Raises InputError: one line that names the option and what was expected."""
        if not 0.01 <= self.resolution_m <= 1.0:
            raise InputError(f"--resolution: expected 0.01 to 1 m, found {self.resolution_m:g}")
        if not 0.0 < self.min_height_m < self.max_height_m <= 100.0:
            raise InputError(
                f"--min-height, --max-height: expected 0 < min < max <= 100 m, "
                f"found {self.min_height_m:g} and {self.max_height_m:g}"
            )
        if not 1.0 <= self.range_m <= 300.0:
            raise InputError(f"--range: expected 1 to 300 m, found {self.range_m:g}")
