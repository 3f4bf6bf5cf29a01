"""The few forms of PromQL that the dashboards are written in."""

from __future__ import annotations

from deploy.grafana.boards.panel import Query

WINDOW = "$__rate_interval"


def rate(name: str, where: str = "", by: str = "", window: str = WINDOW) -> str:
    """A counter's increase a second, summed."""
    return f"{_sum(by)}(rate({name}{_of(where)}[{window}]))"


def events(name: str, where: str = "", by: str = "", window: str = WINDOW) -> str:
    """How often a counter has counted in the window, summed."""
    return f"{_sum(by)}(increase({name}{_of(where)}[{window}]))"


def total(name: str, where: str = "", by: str = "") -> str:
    """A gauge, summed."""
    return f"{_sum(by)}({name}{_of(where)})"


def highest(name: str, where: str = "", by: str = "") -> str:
    """A gauge's largest value."""
    return f"max{f' by ({by}) ' if by else ''}({name}{_of(where)})"


def quantile(share: float, name: str, where: str = "", by: str = "") -> str:
    """Of a histogram's observations in the window."""
    return f"histogram_quantile({share:g}, {rate(f'{name}_bucket', where, f'le, {by}' if by else 'le')})"


def mean(name: str, where: str = "", by: str = "") -> str:
    """Of a histogram's observations in the window."""
    return f"{rate(f'{name}_sum', where, by)} / {rate(f'{name}_count', where, by)}"


def quantiles(name: str, where: str = "") -> tuple[Query, ...]:
    """Median and tail of a histogram."""
    return tuple(Query(quantile(share, name, where), f"p{100 * share:g}") for share in (0.5, 0.9, 0.99))


def _sum(by: str) -> str:
    return f"sum by ({by}) " if by else "sum"


def _of(where: str) -> str:
    return f"{{{where}}}" if where else ""
