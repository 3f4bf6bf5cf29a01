"""How a check's numbers are written."""

from __future__ import annotations

import numpy as np
import pytest
from rich.console import Console
from rich.table import Table

from splitslam.check.mounting import Mounting, findings
from splitslam.check.show import _add_mounting

NEARLY_NOTHING = -1e-6


@pytest.mark.parametrize("unknown", [None, np.array([NEARLY_NOTHING, 0.6, 0.8])])
def test_no_number_is_minus_nothing(unknown: np.ndarray | None) -> None:
    R = np.eye(3) + NEARLY_NOTHING
    axis = np.array([NEARLY_NOTHING, -0.0, 1.0])
    for angle_deg, offset_s in ((5.0, NEARLY_NOTHING), (0.1, 0.03)):
        place = Mounting(angle_deg, 0.1, axis, unknown, 30.0, R, NEARLY_NOTHING, offset_s, 1e-4, 0.01, 0.9)
        table, console = Table(), Console(record=True, width=200)
        _add_mounting(table, place)
        console.print(table)
        said = [console.export_text(), *(finding.line for finding in findings(place, 0.1))]
        assert len(said) > 1
        for text in said:
            assert not any(word.startswith("-0") and float(word) == 0 for word in numbers(text)), text


def numbers(text: str) -> list[str]:
    words = "".join(c if c in "+-.0123456789" else " " for c in text).split()
    return [word.rstrip(".") for word in words if any(c.isdigit() for c in word)]
