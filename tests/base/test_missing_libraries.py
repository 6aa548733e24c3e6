"""What needs an extra that is not installed: one line before anything runs, and the page says so where it offers it."""

import importlib.util
from typing import Any

import pytest

from hapnet import installing
from hapnet.assembly.build import prepare
from hapnet.errors import MissingLibrary
from hapnet.ext.page import choices
from hapnet.params import Params
from tests.conftest import ROOT

RING = f"mesh:{ROOT / 'examples' / 'ring.obj'}?unit=mm"


@pytest.fixture
def hidden(monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """Modules that are not found, as in an environment without them."""
    gone: set[str] = set()
    real = importlib.util.find_spec

    def find(name: str, package: str | None = None) -> Any:
        return None if name in gone else real(name, package)

    monkeypatch.setattr(installing, "find_spec", find)
    return gone


@pytest.mark.parametrize(("module", "library"), [("scipy", "scipy"), ("igl", "libigl"), ("trimesh", "trimesh")])
def test_a_mesh_names_each_library_that_is_missing_before_it_is_read(
    module: str, library: str, hidden: set[str]
) -> None:
    hidden.add(module)
    with pytest.raises(MissingLibrary, match=f"a scene with a mesh needs {library}, of the extra `mesh`"):
        prepare(Params().set({"scene": RING}), "sampled")


@pytest.mark.parametrize(("module", "label", "extra"), [("scipy", "mesh", "mesh"), ("mujoco", "dominoes", "mujoco")])
def test_the_page_says_which_scene_needs_an_extra(module: str, label: str, extra: str, hidden: set[str]) -> None:
    assert label in choices._offered()
    hidden.add(module)
    offered = choices._offered()
    assert label not in offered
    assert f"{label} (needs the extra {extra})" in offered
    assert len(offered) == len(choices.SCENES)
