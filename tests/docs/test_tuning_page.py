"""docs/tuning.md names options as the configuration does, with the defaults that it has."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import pydantic
import pytest

from edge_agent.config import AgentConfig
from map_service.config import ServiceConfig
from splitslam.config import parse_yaml
from splitslam.robot import Robot
from tests.conftest import ROOT

TEXT = (ROOT / "docs" / "tuning.md").read_text()
MODELS: dict[str, type[pydantic.BaseModel]] = {"agent": AgentConfig, "service": ServiceConfig, "robot file": Robot}
_TABLE = re.compile(rf"^\| ({'|'.join(MODELS)}) \| default \| .* \|\n\|[-|]+\|\n((?:\|.*\|\n)+)", re.MULTILINE)
_SIZE = re.compile(r"(\d+) (MiB|GiB)")
_DOTTED = re.compile(r"`([a-z_]+(?:\.[a-z_]+)+)`")
_BYTES = {"MiB": 2**20, "GiB": 2**30}


@dataclass(frozen=True, slots=True)
class Row:
    """One option of a table. default: as the page writes it."""

    model: str
    option: str
    default: str


def rows_of(text: str) -> list[Row]:
    rows = []
    for model, body in _TABLE.findall(text):
        for line in body.splitlines():
            option, default, _ = (cell.strip() for cell in line.strip("|").split("|", 2))
            rows.append(Row(model, option.strip("`"), default))
    return rows


def default_of(model: type[pydantic.BaseModel], option: str) -> Any:
    """Raises KeyError for an option that there is not."""
    *sections, name = option.split(".")
    for section in sections:
        model = _section(model.model_fields[section].annotation)
    return model.model_fields[name].get_default(call_default_factory=True)


def _section(annotation: Any) -> type[pydantic.BaseModel]:
    """The model in `Model` or `Model | None`; one without fields where there is none."""
    for kind in (annotation, *get_args(annotation)):
        if isinstance(kind, type) and issubclass(kind, pydantic.BaseModel):
            return kind
    return pydantic.BaseModel


def meant(cell: str) -> Any:
    if size := _SIZE.fullmatch(cell):
        return int(size[1]) * _BYTES[size[2]]
    return parse_yaml(f"value: {cell}", "docs/tuning.md")["value"]


def problem_with(row: Row) -> str | None:
    try:
        actual = default_of(MODELS[row.model], row.option)
    except KeyError:
        return f"{row.model}: {row.option}: no such option"
    actual = list(actual) if isinstance(actual, tuple) else str(actual) if isinstance(actual, Path) else actual
    return None if meant(row.default) == actual else f"{row.option}: {row.default}: expected {actual!r}"


ROWS = rows_of(TEXT)


def test_every_table_of_options_is_read() -> None:
    headers = re.findall(r"^\| [^|]+ \| default \|", TEXT, re.MULTILINE)
    assert len(headers) == len(_TABLE.findall(TEXT)) > 10
    assert len({(row.model, row.option) for row in ROWS}) == len(ROWS) > 70


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.model}-{row.option}")
def test_an_option_has_the_name_and_the_default_that_the_page_says(row: Row) -> None:
    assert problem_with(row) is None


def test_options_in_the_text_are_options_as_well() -> None:
    unknown = [name for name in _DOTTED.findall(TEXT) if not any(_is_option(model, name) for model in MODELS.values())]
    assert not unknown


def _is_option(model: type[pydantic.BaseModel], name: str) -> bool:
    try:
        default_of(model, name)
    except KeyError:
        return name.rpartition(".")[2] in ("md", "py", "conf", "yaml", "bag", "tum")
    return True


@pytest.mark.parametrize(
    "row",
    [
        Row("agent", "uplink.max_kpbs", "null"),
        Row("agent", "quota.site_bytes", "0"),
        Row("agent", "spool.max_bytes", "2 MiB"),
        Row("service", "limits.client.streams.more", "16"),
        Row("robot file", "lidar.stamp", "end"),
        Row("robot file", "wheels", "{}"),
    ],
)
def test_a_name_or_a_default_that_is_wrong_is_found(row: Row) -> None:
    assert problem_with(row)
