"""Boards in Grafana's own terms, by its foundation SDK."""

from __future__ import annotations

import json
from typing import Any

from grafana_foundation_sdk.builders import common, dashboard, prometheus, stat, statetimeline, table, timeseries
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.models import common as c
from grafana_foundation_sdk.models import dashboard as d
from grafana_foundation_sdk.models.prometheus import PromQueryFormat

from deploy.grafana.boards.panel import COLUMNS, Board, Panel, Query, Row, Variable

_SOURCE = d.DataSourceRef(type_val="prometheus", uid="prometheus")  # provisioning/datasources/prometheus.yaml
_GREEN, _YELLOW, _RED, _BLUE, _GREY = "#73BF69", "#F2CC0C", "#F2495C", "#5794F2", "#8A8F98"
_TAG = "splitslam"
# splitslam.v1.TrackingState
_STATES = {
    "0": ("starting", _GREY), "1": ("initialising", _BLUE), "2": ("tracking", _GREEN), "3": ("degenerate", _YELLOW),
    "4": ("unanchored", "#FF9830"), "5": ("localising", "#B877D9"), "6": ("lost", _RED),
}  # fmt: skip


def as_json(board: Board) -> str:
    """What Grafana reads."""
    return JSONEncoder(sort_keys=True, indent=1).encode(_dashboard(board).build()) + "\n"


def as_dict(board: Board) -> dict[str, Any]:
    """The same, parsed."""
    return json.loads(as_json(board))


def _dashboard(board: Board) -> dashboard.Dashboard:
    built = (
        dashboard.Dashboard(board.title)
        .uid(board.uid)
        .description(board.what)
        .tags([_TAG])
        .readonly()
        .time("now-30m", "now")
        .refresh("10s")
        .timezone("browser")
        .tooltip(d.DashboardCursorSync.CROSSHAIR)
        .link(
            dashboard.DashboardLink("SplitSLAM").type(d.DashboardLinkType.DASHBOARDS).tags([_TAG]).keep_time(True)
        )
    )  # fmt: skip
    for variable in board.variables:
        built.with_variable(_variable(variable))
    y = number = 0
    for row in board.rows:
        number += 1
        built.with_panel(_head(row, number, y))  # an open row's panels stand beside it
        x, y = 0, y + 1
        for panel in row.panels:
            if x + panel.width > COLUMNS:
                x, y = 0, y + row.height
            number += 1
            place = d.GridPos(h=row.height, w=panel.width, x=x, y=y)
            built.with_panel(_panel(panel).id(number).grid_pos(place))
            x += panel.width
        y += row.height
    return built


class _Head:
    """The title of a row."""

    def __init__(self, row: d.RowPanel) -> None:
        self._row = row

    def build(self) -> Any:
        return self._row


def _head(row: Row, number: int, y: int) -> Any:
    place = d.GridPos(h=1, w=COLUMNS, x=0, y=y)
    return _Head(d.RowPanel(title=row.title, collapsed=False, grid_pos=place, id_val=number, panels=[]))


def _variable(variable: Variable) -> dashboard.QueryVariable:
    built = (
        dashboard.QueryVariable(variable.name)
        .label(variable.label)
        .datasource(_SOURCE)
        .query({"query": f"label_values({variable.metric}, {variable.of})", "refId": variable.name})
        .refresh(d.VariableRefresh.ON_TIME_RANGE_CHANGED)
        .sort(d.VariableSort.NATURAL_ASC)
        .multi(variable.multi)
        .include_all(variable.multi)
    )
    return built.all_value(".*").current(d.VariableOption(text="All", value="$__all")) if variable.multi else built


def _panel(panel: Panel) -> Any:
    make = {"lines": _lines, "stacked": _lines, "number": _number, "states": _states, "table": _table}[panel.kind]
    built = make(panel).title(panel.title).description(panel.what).datasource(_SOURCE)
    for k, query in enumerate(panel.queries):
        built.with_target(_target(query, chr(ord("A") + k), panel))
    return built


def _target(query: Query, ref_id: str, panel: Panel) -> prometheus.Dataquery:
    built = prometheus.Dataquery().expr(query.expr).ref_id(ref_id).datasource(_SOURCE)
    if panel.kind == "table":
        return built.instant().format(PromQueryFormat.TABLE)
    return built.range().legend_format(query.legend or "__auto")


def _lines(panel: Panel) -> timeseries.Panel:
    stacked = panel.kind == "stacked"
    legend = (
        common.VizLegendOptions()
        .show_legend(True)
        .display_mode(c.LegendDisplayMode.TABLE)
        .placement(c.LegendPlacement.BOTTOM)
        .calcs(["lastNotNull", "max"])
    )
    built = (
        timeseries.Panel()
        .unit(panel.unit)
        .min(0.0)
        .line_width(1.5)
        .fill_opacity(30 if stacked else 8)
        .gradient_mode(c.GraphGradientMode.OPACITY)
        .show_points(c.VisibilityMode.NEVER)
        .color_scheme(dashboard.FieldColor().mode(d.FieldColorModeId.PALETTE_CLASSIC_BY_NAME))
        .tooltip(common.VizTooltipOptions().mode(c.TooltipDisplayMode.MULTI).sort(c.SortOrder.DESCENDING))
        .legend(legend)
        .thresholds(_thresholds(panel.warn, panel.bad, panel.low))
    )
    if stacked:
        built.stacking(common.StackingConfig().mode(c.StackingMode.NORMAL))
    if panel.warn is not None or panel.bad is not None:
        built.thresholds_style(common.GraphThresholdsStyleConfig().mode(c.GraphThresholdsStyleMode.DASHED))
    return built


def _number(panel: Panel) -> stat.Panel:
    return (
        stat.Panel()
        .unit(panel.unit)
        .graph_mode(c.BigValueGraphMode.AREA)
        .color_mode(c.BigValueColorMode.VALUE)
        .reduce_options(common.ReduceDataOptions().calcs(["lastNotNull"]))
        .color_scheme(dashboard.FieldColor().mode(d.FieldColorModeId.THRESHOLDS))
        .thresholds(_thresholds(panel.warn, panel.bad, panel.low))
    )


def _states(panel: Panel) -> statetimeline.Panel:
    return (
        statetimeline.Panel()
        .mappings([_state_names()])
        .color_scheme(dashboard.FieldColor().mode(d.FieldColorModeId.THRESHOLDS))
        .thresholds(_thresholds(None, None, False))
        .show_value(c.VisibilityMode.AUTO)
        .row_height(0.8)
        .line_width(0)
        .fill_opacity(80)
        .legend(common.VizLegendOptions().show_legend(False))
    )


def _table(panel: Panel) -> table.Panel:
    """One row for each value of `key`, one column for each query."""
    heads = {f"Value #{chr(ord('A') + k)}": query.legend for k, query in enumerate(panel.queries)}
    built = table.Panel().thresholds(_thresholds(None, None, False)).filterable(True)
    built.with_transformation(
        d.DataTransformerConfig(id_val="joinByField", options={"byField": panel.key, "mode": "outer"})
    )
    hidden = {f"Time {k + 1}": True for k in range(len(panel.queries))} | {"Time": True}
    options = {"excludeByName": hidden, "renameByName": heads, "indexByName": {}}
    built.with_transformation(d.DataTransformerConfig(id_val="organize", options=options))
    for query in panel.queries:
        built.override_by_name(query.legend, _column(query))
    if panel.link:
        url = f"/d/{panel.link}?var-{panel.key}=${{__data.fields.{panel.key}}}&${{__url_time_range}}"
        link = {"title": "this one alone", "url": url}
        built.override_by_name(panel.key, [d.DynamicConfigValue(id_val="links", value=[link])])
    return built


def _column(query: Query) -> list[d.DynamicConfigValue]:
    if query.unit == "state":
        mapping = json.loads(JSONEncoder().encode(_state_names()))
        return [
            d.DynamicConfigValue(id_val="mappings", value=[mapping]),
            d.DynamicConfigValue(id_val="custom.cellOptions", value={"type": "color-text"}),
        ]
    steps = json.loads(JSONEncoder().encode(_thresholds(query.warn, query.bad, False).build()))
    coloured = query.warn is not None or query.bad is not None
    return [
        d.DynamicConfigValue(id_val="unit", value=query.unit or "short"),
        d.DynamicConfigValue(id_val="thresholds", value=steps),
        d.DynamicConfigValue(id_val="custom.cellOptions", value={"type": "color-text" if coloured else "auto"}),
    ]


def _state_names() -> d.ValueMap:
    options = {
        value: d.ValueMappingResult(text=text, color=colour, index=int(value))
        for value, (text, colour) in _STATES.items()
    }
    return d.ValueMap(options=options)


def _thresholds(warn: float | None, bad: float | None, low: bool) -> dashboard.ThresholdsConfig:
    """Green, from `warn` on yellow, from `bad` on red; `low`: red below `bad`, yellow below `warn`."""
    marks = [(bad, _RED), (warn, _YELLOW)] if low else [(warn, _YELLOW), (bad, _RED)]
    known = [(value, colour) for value, colour in marks if value is not None]
    if low:  # a colour holds from its value on: each mark ends the colour below it
        below = [colour for _, colour in known] + [_GREEN]
        steps = [(None, below[0])] + [(value, below[k + 1]) for k, (value, _) in enumerate(known)]
    else:
        steps = [(None, _GREEN), *known]
    mode = d.ThresholdsMode.ABSOLUTE
    return dashboard.ThresholdsConfig().mode(mode).steps([d.Threshold(value=v, color=colour) for v, colour in steps])
