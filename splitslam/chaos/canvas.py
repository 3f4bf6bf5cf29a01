"""A small drawing in a terminal: every character cell is 2 x 4 braille dots."""

from __future__ import annotations

from collections.abc import Iterable

from rich.style import Style
from rich.text import Text

_DOT = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))  # Unicode's numbering, by row and column


class Canvas:
    """`columns` x `rows` cells that show the rectangle of `points_m` (x, y), to scale, x to the right."""

    def __init__(self, columns: int, rows: int, points_m: Iterable[tuple[float, float]]) -> None:
        xs, ys = zip(*points_m, strict=True)
        self.columns, self.rows = columns, rows
        width_m, height_m = max(max(xs) - min(xs), 1e-3), max(max(ys) - min(ys), 1e-3)
        self._dots_per_m = min((2 * columns - 4) / width_m, (4 * rows - 8) / height_m)
        self._centre_m = (max(xs) + min(xs)) / 2, (max(ys) + min(ys)) / 2
        self._cells = [[(0, Style()) for _ in range(columns)] for _ in range(rows)]
        self._marks: dict[tuple[int, int], tuple[str, Style]] = {}

    def dot(self, x_m: float, y_m: float, style: Style) -> None:
        """One dot; what lies outside is left out. A cell has the colour of its last dot."""
        column, row = self._dot_at(x_m, y_m)
        if 0 <= column < 2 * self.columns and 0 <= row < 4 * self.rows:
            bits, _ = self._cells[row // 4][column // 2]
            self._cells[row // 4][column // 2] = bits | _DOT[row % 4][column % 2], style

    def mark(self, x_m: float, y_m: float, text: str, style: Style) -> None:
        """A character over whatever is drawn there."""
        column, row = self._dot_at(x_m, y_m)
        self._marks[row // 4, column // 2] = text, style

    def _dot_at(self, x_m: float, y_m: float) -> tuple[int, int]:
        x, y = self._centre_m
        return (
            round((x_m - x) * self._dots_per_m + self.columns),
            round((y - y_m) * self._dots_per_m + 2 * self.rows),
        )

    def text(self) -> Text:
        """The drawing, `rows` lines."""
        out = Text(no_wrap=True)
        for row, cells in enumerate(self._cells):
            for column, (bits, style) in enumerate(cells):
                mark = self._marks.get((row, column))
                out.append(*(mark or (chr(0x2800 + bits) if bits else " ", style)))
            if row + 1 < self.rows:
                out.append("\n")
        return out
