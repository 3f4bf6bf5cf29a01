"""The look of the tables that benchmarks print."""

from __future__ import annotations

from rich.table import Table


def figures_table(title: str, first: str, *columns: str) -> Table:
    """Names in the first column, figures in the others."""
    table = Table(title=title, title_justify="left", title_style="bold", box=None, padding=(0, 1), pad_edge=False)
    table.add_column(first, no_wrap=True)
    for column in columns:
        table.add_column(column, justify="right", no_wrap=True)
    return table
