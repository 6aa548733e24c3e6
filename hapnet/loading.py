"""Imports a user's own parts, given as ``module:Name``, and reports their errors in one line."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from hapnet.errors import InvalidParameter


def load(parameter: str, name: str, allowed: str) -> Any:
    """The object that ``module:Name`` names. Importing it runs the user's code, which may raise anything.

    Raises
    ------
    InvalidParameter : `name` has no colon, or the import failed; it names `parameter` and says what is `allowed`.
    """
    module, colon, attribute = name.partition(":")
    if not (module and colon and attribute):
        raise InvalidParameter(parameter, name, allowed)
    try:
        return getattr(import_module(module), attribute)
    except Exception as error:
        raise InvalidParameter(parameter, name, f"{allowed} ({cause(error)})") from error


def cause(error: BaseException) -> str:
    """The error in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())
