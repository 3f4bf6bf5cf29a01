"""Typed configuration: YAML and environment in, frozen models out, one clear line for every mistake."""

from __future__ import annotations

import difflib
import os
import re
import typing
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import pydantic
import yaml
from yaml.composer import ComposerError

from splitslam.errors import InputError

M = TypeVar("M", bound=pydantic.BaseModel)


class Model(pydantic.BaseModel):
    """Base of every configuration: frozen, an unknown key is an error."""

    model_config = pydantic.ConfigDict(frozen=True, extra="forbid")


class _Loader(yaml.SafeLoader):
    """YAML as people mean it: `off` and `no` stay text, `1e-4` is a number, a key twice is an error."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):  # a few of them in each other make gigabytes of a kilobyte
            mark = self.peek_event().start_mark
            raise ComposerError(None, None, "aliases (*name) are not taken", mark)
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, (str, int, float)) and key in seen:
                raise yaml.constructor.ConstructorError(None, None, f"key {key} is given twice", key_node.start_mark)
            seen.add(key if isinstance(key, (str, int, float)) else id(key_node))
        return super().construct_mapping(node, deep)


_TAGS = ("tag:yaml.org,2002:bool", "tag:yaml.org,2002:int", "tag:yaml.org,2002:float", "tag:yaml.org,2002:timestamp")
_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag not in _TAGS]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}

_Loader.add_implicit_resolver(_TAGS[0], re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), list("tTfF"))
_Loader.add_implicit_resolver(_TAGS[1], re.compile(r"^[-+]?[0-9]+$"), list("-+0123456789"))
_Loader.add_implicit_resolver(
    _TAGS[2],
    re.compile(
        r"^(?:[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf)|\.(?:nan|NaN))$"
    ),
    list("-+0123456789."),
)


def load(cls: type[M], path: Path | None, env_prefix: str | None = None) -> M:
    """Reads `cls` from a YAML file (None: defaults) and, over it, from the environment.

    With `env_prefix` SPLITSLAM_EDGE the variable SPLITSLAM_EDGE__UPLINK__MAX_KBPS sets uplink.max_kbps.
    Raises InputError, one line: file (or environment), dotted key, what was expected.
    """
    data = {} if path is None else parse_yaml(read_text(path), str(path))
    name = "environment" if path is None else str(path)
    if env_prefix is not None:
        data = overlay_environment(cls, data, env_prefix)
    return validate(cls, data, name)


def overlay_environment(cls: type[pydantic.BaseModel], data: dict[str, Any], env_prefix: str) -> dict[str, Any]:
    """`data` with the keys of `cls` that the environment sets under `env_prefix`; InputError for unknown ones."""
    return _overlay(cls, data, env_prefix + "__", os.environ)


def read_text(path: Path) -> str:
    """The file's text; InputError when it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not a text file: expected YAML in UTF-8") from error


def parse_yaml(text: str, name: str) -> dict[str, Any]:
    """YAML text -> mapping; InputError naming `name` and the line when it is none."""
    try:
        data = yaml.load(text, Loader=_Loader)
    except RecursionError:
        raise InputError(f"{name}: not valid YAML: nested too deeply") from None
    except (ValueError, OverflowError) as error:  # of a scalar that looks like a number and is none
        raise InputError(f"{name}: not valid YAML: {error}"[:300]) from error
    except yaml.YAMLError as error:
        raise InputError(
            f"{name}{_where(error)}: not valid YAML: {getattr(error, 'problem', None) or error}"
        ) from error
    if data is None:
        return {}
    if not isinstance(data, dict):
        raise InputError(f"{name}: expected keys and values, found {type(data).__name__}")
    return data


def _where(error: yaml.YAMLError) -> str:
    """Where the mistake is; the parser says where it noticed, which is a line later when something has no end."""
    noticed, begun = getattr(error, "problem_mark", None), getattr(error, "context_mark", None)
    if noticed is None:
        return ""
    if begun is not None and begun.line < noticed.line:
        ended = noticed.buffer is None or noticed.buffer[noticed.pointer] == "\0"
        within = str(getattr(error, "context", None))
        if within.startswith(("while scanning a simple key", "while scanning a quoted scalar")):
            return f", line {begun.line + 1}"
        if within.startswith("while parsing a flow"):
            return f", line {begun.line + 1}" if ended else f", lines {begun.line + 1} to {noticed.line + 1}"
    return f", line {noticed.line + 1}"


def validate(cls: type[M], data: Mapping[str, Any], name: str) -> M:
    """Mapping -> model; every problem in one InputError line that starts with `name`."""
    try:
        return cls.model_validate(dict(data))
    except pydantic.ValidationError as error:
        problems = [_explain(cls, problem) for problem in error.errors(include_url=False)]
        raise InputError(f"{name}: {'; '.join(problems)}") from error


def dump(model: pydantic.BaseModel) -> str:
    """Model -> YAML, defaults filled in; `load` reads it back."""
    return yaml.safe_dump(model.model_dump(mode="json"), sort_keys=False, default_flow_style=None, width=120)


def _explain(cls: type[pydantic.BaseModel], problem: Any) -> str:
    key = ".".join(str(part) for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        nearest = _nearest_key(cls, tuple(str(part) for part in problem["loc"]))
        return f"{key}: unknown key; nearest known: {nearest}"
    if problem["type"] == "missing":
        return f"{key}: must be given"
    message = " ".join(str(problem["msg"]).removeprefix("Value error, ").split())
    value = problem.get("input")
    shown = f", found {value!r}" if isinstance(value, (str, int, float)) else ""
    return f"{key}: {message}{shown}" if key else message


def _nearest_key(cls: type[pydantic.BaseModel], location: tuple[str, ...]) -> str:
    *parents, key = location
    known = dict.fromkeys(_dotted_keys(cls))
    prefix = "".join(f"{part}." for part in parents)
    siblings = [dotted for dotted in known if dotted.startswith(prefix) and "." not in dotted.removeprefix(prefix)]

    def likeness(dotted: str) -> float:
        return difflib.SequenceMatcher(None, key.lower(), dotted.rsplit(".", 1)[-1].lower()).ratio()

    best = max(siblings, key=likeness, default="")
    if not best or likeness(best) < 0.6:  # the right key under the wrong section is a common slip
        best = max([best, *known] if best else known, key=likeness, default="none")
    return best


def _dotted_keys(cls: type[pydantic.BaseModel], prefix: str = "") -> Iterator[str]:
    for name, info in cls.model_fields.items():
        yield prefix + name
        section = _section(info.annotation)
        if section is not None:
            yield from _dotted_keys(section, f"{prefix}{name}.")


def _section(annotation: Any) -> type[pydantic.BaseModel] | None:
    """The model inside `Section` or `Section | None`."""
    for candidate in (annotation, *typing.get_args(annotation)):
        if isinstance(candidate, type) and issubclass(candidate, pydantic.BaseModel):
            return candidate
    return None


def _overlay(
    cls: type[pydantic.BaseModel], data: dict[str, Any], prefix: str, environment: Mapping[str, str]
) -> dict[str, Any]:
    known = {dotted.lower(): dotted for dotted in _dotted_keys(cls)}
    for variable in sorted(environment):
        if not variable.startswith(prefix):
            continue
        dotted = variable.removeprefix(prefix).replace("__", ".").lower()
        if dotted not in known:
            nearest = _nearest_key(cls, tuple(dotted.split("."))).upper().replace(".", "__")
            raise InputError(f"environment: {variable}: unknown key; nearest known: {prefix}{nearest}")
        *sections, key = known[dotted].split(".")
        node = data = dict(data)
        for section in sections:
            child = node.get(section)
            node[section] = dict(child) if isinstance(child, dict) else {}
            node = node[section]
        try:
            node[key] = yaml.load(environment[variable], Loader=_Loader)
        except yaml.YAMLError as error:
            raise InputError(f"environment: {variable}: not a valid value: {environment[variable]!r}") from error
    return data
