"""The parameters as a JSON schema: with it an editor completes and checks a file for `--params`."""

from __future__ import annotations

import dataclasses
import inspect
from dataclasses import fields, is_dataclass
from typing import Any

from hapnet.param_values import Allowed, Range

DIALECT = "http://json-schema.org/draft-07/schema#"
"""The dialect that editors for TOML support."""

_TYPES = {str: "string", bool: "boolean", int: "integer", float: "number"}


def schema(params: Any) -> dict[str, Any]:
    """The schema of a file of parameters; its defaults are the values of `params`."""
    whole = _section(params)
    whole["properties"] |= {name: _section(section) for name, section in params.law_sections().items()}
    return {"$schema": DIALECT, "title": "Parameters of hapnet"} | whole


def _section(node: Any) -> dict[str, Any]:
    properties = {}
    for spec in fields(node):
        value = getattr(node, spec.name)
        if is_dataclass(value):
            properties[spec.name] = _section(value)
        elif spec.metadata:
            properties[spec.name] = _parameter(value, spec)
    description = inspect.cleandoc(type(node).__doc__ or "")
    return {"type": "object", "description": description, "properties": properties, "additionalProperties": False}


def _parameter(value: Any, spec: dataclasses.Field[Any]) -> dict[str, Any]:
    about = {"description": spec.metadata["doc"], "default": value}
    if spec.type != "Matrix":
        return about | {"type": _TYPES[type(value)]} | _limits(spec.metadata["allowed"])
    row = {"type": "array", "items": {"type": "number"}, "minItems": 1}
    rows = {"type": "array", "items": row, "minItems": 1}
    return about | {"anyOf": [{"type": "number"} | _limits(spec.metadata["allowed"]), row, rows]}


def _limits(allowed: Allowed) -> dict[str, Any]:
    if not isinstance(allowed, Range):
        return {"enum": list(allowed)}
    limits = {"exclusiveMinimum": allowed.above, "minimum": allowed.at_least, "maximum": allowed.at_most}
    return {name: limit for name, limit in limits.items() if limit is not None}
