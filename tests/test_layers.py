"""The rules of import: who may know whom."""

from __future__ import annotations

import ast
import importlib.util
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MODULES = sorted(path.relative_to(ROOT) for package in ("hapnet", "netem") for path in (ROOT / package).rglob("*.py"))

OUTSIDE_WORLD = {"time", "asyncio", "threading", "random", "socket", "zenoh"}
CORE = {"hapnet.control", "hapnet.plant", "hapnet.wire", "netem"}
PURE_NETEM = {"netem/profile.py", "netem/models.py", "netem/link.py"}
LONGEST = 420


def name_of(module: Path) -> str:
    return ".".join(module.with_suffix("").parts).removesuffix(".__init__")


def layer_of(name: str) -> str | None:
    return next((layer for layer in sorted(CORE) if name == layer or name.startswith(layer + ".")), None)


def imports(source: str, module: str, is_package: bool = False) -> Iterator[str]:
    """Every module that `source` imports, anywhere in it, under its absolute name."""
    package = module if is_package else module.rpartition(".")[0]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


def imports_of(module: Path) -> set[str]:
    return set(imports((ROOT / module).read_text("utf-8"), name_of(module), module.name == "__init__.py"))


def roots(names: set[str]) -> set[str]:
    return {name.partition(".")[0] for name in names}


def test_every_way_to_import_is_seen() -> None:
    source = "import a.b\nfrom . import c\nfrom ..d import e\ndef f():\n    import g\n    from h.i import j\n"
    found = set(imports(source, "p.q.r"))
    assert {"a.b", "p.q", "p.q.c", "p.d", "p.d.e", "g", "h.i", "h.i.j"} == found
    assert set(imports("from . import c", "p.q", is_package=True)) == {"p.q", "p.q.c"}


def test_there_are_modules_in_every_layer() -> None:
    assert {layer_of(name_of(module)) for module in MODULES} == {*CORE, None}
    assert {str(module) for module in MODULES} >= PURE_NETEM


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_core_layers_do_not_import_one_another(module: Path) -> None:
    own = layer_of(name_of(module))
    if own is None:
        return
    others = {name for name in imports_of(module) if layer_of(name) not in (None, own)}
    assert not others


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_core_reaches_nothing_outside_itself(module: Path) -> None:
    """No clock, no generator but one passed in, no I/O; and no runtime, command or endpoint."""
    layer = layer_of(name_of(module))
    if layer is None or (layer == "netem" and str(module) not in PURE_NETEM):
        return
    found = imports_of(module)
    assert not roots(found) & OUTSIDE_WORLD
    below = (layer, "hapnet.errors", "hapnet.checks", "hapnet.histogram", "hapnet.loading")
    assert not {name for name in found if name.startswith("hapnet.") and not name.startswith(below)}


@pytest.mark.parametrize("module", [module for module in MODULES if module.parts[0] == "netem"], ids=str)
def test_netem_knows_nothing_of_hapnet(module: Path) -> None:
    assert "hapnet" not in roots(imports_of(module))


def test_endpoint_knows_control_and_wire_only() -> None:
    own = {name for name in imports_of(Path("hapnet/endpoint.py")) if name.startswith(("hapnet", "netem"))}
    allowed = ("hapnet.control", "hapnet.wire", "hapnet.checks", "hapnet.errors")
    assert not {name for name in own if not name.startswith(allowed)}
    assert not roots(imports_of(Path("hapnet/endpoint.py"))) & OUTSIDE_WORLD


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_only_commands_measure(module: Path) -> None:
    """Benchmarks look at everything; nothing looks at them but their command, which they do not know."""
    found = imports_of(module)
    if module.parts[:2] == ("hapnet", "bench"):
        assert not {name for name in found if name.startswith(("hapnet.commands", "hapnet.cli"))}
    elif module.parts[:2] != ("hapnet", "commands"):
        assert not {name for name in found if name.startswith("hapnet.bench")}


@pytest.mark.parametrize("module", MODULES, ids=str)
def test_modules_stay_short(module: Path) -> None:
    assert len((ROOT / module).read_text("utf-8").splitlines()) <= LONGEST
