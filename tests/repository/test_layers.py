"""The rules of import: who may know whom."""

import ast
import gc
import importlib.util
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import hapnet
from hapnet.laws import COUPLING_NAMES

ROOT = Path(__file__).resolve().parents[2]
MODULES = sorted(path.relative_to(ROOT) for package in ("hapnet", "netem") for path in (ROOT / package).rglob("*.py"))

FILES = {"csv", "io", "os", "pathlib", "shutil", "tempfile"}
CLOCKS_AND_OTHERS = {
    "asyncio", "datetime", "multiprocessing", "random", "secrets", "select", "signal", "socket", "subprocess",
    "threading", "time", "uuid", "zenoh",
}  # fmt: skip
"""Clocks, generators of their own, and whatever waits for, or speaks with, threads, processes and networks."""

PURE_NETEM = {f"netem/{name}.py" for name in (  # all that a link in virtual time consists of
    "columns", "delay_table", "draws", "effects", "expectation", "line", "link", "loss_chain", "models", "offering",
    "presets", "profile", "rate_trace", "recorded", "resend", "retransmission", "slots", "stats", "tc", "timeline",
    "trace", "units", "words",
)}  # fmt: skip
MAX_LENGTH = 420
MOST_ATTRIBUTES = 20
SHORT, MOST_SHORT = 60, 40

BASE = {
    "errors", "checks", "params", "laws", "param_sections", "param_values", "param_schema", "param_sources",
    "installing", "loading", "units", "versions", "file_content",
}  # fmt: skip
BELOW_ASSEMBLY = {"records", "mechanics", "control", "plant", "wire", "recording", "side", "couplings"}
MAY_IMPORT = {  # a package, and what it may know beside itself and the base
    "records": set(),
    "mechanics": {"records"},
    "control": {"records", "mechanics"},
    "plant": {"records", "mechanics"},
    "wire": {"records"},
    "recording": {"mechanics", "plant", "wire"},
    "side": {"records", "mechanics", "control", "plant", "wire", "recording"},
    "couplings": {"records", "mechanics", "control", "wire"},
    "processes": set(),
    "devices": {"records", "mechanics", "plant"},
    "assembly": BELOW_ASSEMBLY | {"devices"},
    "summary": BELOW_ASSEMBLY,
    "transport": {"records", "wire"},
    "simulation": BELOW_ASSEMBLY | {"assembly", "summary", "processes"},
    "realtime": BELOW_ASSEMBLY | {"assembly", "summary", "transport", "processes"},
}
MAY_IMPORT["commands"] = {*MAY_IMPORT}
"""The core; `cli.py` belongs to the commands."""

ABOVE = {
    "laws": set(),
    "engines": {"solids"},
    "solids": set(),
    "soft": {"solids", "engines"},
    "tools": {"solids", "engines"},
    "arms": {"solids"},
    "robots": {"arms", "engines", "devices"},
    "devices": {"arms"},
    "metrics": {"solids", "tools"},
    "pictures": {"metrics", "arms", "solids"},
    "study": {"metrics", "pictures", "arms", "tools"},
    "page": {"laws", "arms", "solids"},
    "many": {"engines", "robots", "solids"},
    "doctor": {"pictures"},
    "compiled": {"laws", "solids", "tools", "arms"},  # it compiles their equations
    "bench": {"compiled", "arms", "tools", "solids", "page", "pictures"},
}
"""The extensions, and which others each may know beside itself. All may know the core; commands, only commands."""

EQUATIONS_TOO = ("laws", "solids", "engines", "soft", "tools", "arms", "compiled")
"""The extensions that are as pure as the core below `assembly`."""
EQUATIONS_OF_MANY = {f"hapnet/ext/many/{name}.py" for name in ("balance", "blocks", "joint", "shared", "turning")}

READS_FILES = {
    "hapnet/laws.py": "a law is a file of a package",
    "hapnet/loading.py": "looks whether any package publishes a part, before it loads what reads that",
    "hapnet/file_content.py": "reads what others may have written: all that is a plain file and not too large",
    "hapnet/params.py": "--params names a file",
    "hapnet/installing.py": "looks for an interpreter that has pip",
    "hapnet/ext/engines/mujoco_model.py": "a scene is a model's file",
    "hapnet/ext/engines/mujoco_sizes.py": "looks at that file, and at those that it includes, before MuJoCo does",
    "netem/trace.py": "a recorded link is a file",
    "netem/recorded.py": "finds out whether a word of a profile is a file, and of which kind",
    "netem/units.py": "opens the files that a profile names",
    "hapnet/ext/solids/mesh_file.py": "a scene's mesh is a file",
    "hapnet/ext/solids/effects_words.py": "a recorded grain is a file",
    "hapnet/ext/solids/volume_file.py": "a scene's voxels are a file",
    "hapnet/recording": "recordings are files; nothing below `assembly` opens one but through it",
    "hapnet/ext/arms/parameters.py": "an arm's URDF is a file",
    "hapnet/records/machine_code.py": "compiled code is kept in a directory",
    "hapnet/ext/compiled/sources.py": "compiled code is cached as long as its sources stay the same",
}
"""What may reach files, of all that lies below `assembly`, and why. Clocks and generators are arguments there too."""

WITHOUT_CLOCKS = {"base", *BELOW_ASSEMBLY, *(f"ext.{name}" for name in EQUATIONS_TOO), "ext.metrics"}

REACHES_OUT = {
    "hapnet/ext/tools/posed.py": {"time"},  # a user's device gets a clock from there, unless it is given another
    "hapnet/ext/compiled/background.py": {"os", "threading"},  # it starts a process, and is one
    "hapnet/ext/compiled/commands.py": {"time"},
}

ADDS_UP = {"records", "mechanics", "control", "plant", "couplings", "side", *(f"ext.{name}" for name in EQUATIONS_TOO)}
"""Whose recordings' bits depend on how a sum is rounded: they add up with `inner` and `added`."""

COUNTS = {f"hapnet/{name}.py" for name in ("plant/integrator", "records/histogram")}
"""Modules of those that count with `sum`, or ask whether any of several numbers is none."""

OPENS_ZENOH = {
    "hapnet/ext/bench/latency.py": "raw Zenoh is what hapnet's latency is held against",
}
"""Modules outside of `transport` that use Zenoh itself, and why."""


def name_of(module: Path) -> str:
    return ".".join(module.with_suffix("").parts).removesuffix(".__init__")


def package_of(name: str) -> str:
    """The part of hapnet that a module belongs to; of another package its name."""
    parts = name.split(".")
    if parts[0] != "hapnet" or len(parts) == 1 or name == "hapnet.ext":
        return parts[0]
    if parts[1] == "ext":
        return f"ext.{parts[2]}"
    return "base" if parts[1] in BASE else "commands" if parts[1] in ("cli", "__main__") else parts[1]


@cache
def nodes(source: str) -> tuple[ast.AST, ...]:
    """All of a module's tree."""
    return tuple(ast.walk(ast.parse(source)))


@pytest.fixture(autouse=True, scope="module")
def _trees_for_these_tests_alone() -> Iterator[None]:
    """They are a million objects, which every collection of garbage would go through."""
    gc.disable()
    yield
    nodes.cache_clear()
    gc.enable()


def imports(source: str, module: str, is_package: bool = False) -> Iterator[str]:
    """Every module that `source` imports, anywhere in it, under its absolute name."""
    package = module if is_package else module.rpartition(".")[0]
    for node in nodes(source):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


@cache
def imports_of(module: Path) -> set[str]:
    return set(imports((ROOT / module).read_text("utf-8"), name_of(module), module.name == "__init__.py"))


def roots(names: set[str]) -> set[str]:
    return {name.partition(".")[0] for name in names}


def test_every_way_to_import_is_seen() -> None:
    source = "import a.b\nfrom . import c\nfrom ..d import e\ndef f():\n    import g\n    from h.i import j\n"
    found = set(imports(source, "p.q.r"))
    assert {"a.b", "p.q", "p.q.c", "p.d", "p.d.e", "g", "h.i", "h.i.j"} == found
    assert set(imports("from . import c", "p.q", is_package=True)) == {"p.q", "p.q.c"}


def test_every_package_has_its_rule() -> None:
    assert {path.parent.name for path in (ROOT / "hapnet").glob("*/*.py")} <= {*MAY_IMPORT, "ext"}
    assert {path.parent.name for path in (ROOT / "hapnet" / "ext").glob("*/*.py")} == ABOVE.keys()
    assert {str(module) for module in MODULES} >= PURE_NETEM | EQUATIONS_OF_MANY


def test_imports_go_one_way() -> None:
    wrong = {}
    for module in MODULES:
        own = package_of(name_of(module))
        if own not in MAY_IMPORT and own != "base":
            continue
        wrong[module] = packages_of(module) - {own, "base", *MAY_IMPORT.get(own, set())}
    assert len(wrong) > 200
    assert not {module: names for module, names in wrong.items() if names}


def test_no_packages_import_one_another() -> None:
    rules = {**MAY_IMPORT, **{f"ext.{name}": {f"ext.{one}" for one in known} for name, known in ABOVE.items()}}
    below: set[str] = set()
    while ready := {name for name, known in rules.items() if name not in below and known <= below}:
        below |= ready
    assert below == rules.keys(), "those that are missing import one another"


def packages_of(module: Path) -> set[str]:
    """The packages of hapnet that a module imports from; a public name of hapnet is of none."""
    names = {name for name in imports_of(module) if name.startswith("hapnet.")}
    return {package_of(name) for name in names if name.removeprefix("hapnet.") not in hapnet.__all__}


def test_an_extension_imports_the_core_and_the_extensions_that_it_declares() -> None:
    core = {"base", *MAY_IMPORT} - {"commands"}
    wrong = {}
    for module in MODULES:
        own = package_of(name_of(module))
        if own.startswith("ext."):
            allowed = {f"ext.{name}" for name in ABOVE[own.removeprefix("ext.")]}
            commands = {"commands"} if module.parts[3].removesuffix(".py") == "commands" else set()
            wrong[module] = packages_of(module) - {own, *core, *allowed, *commands}
    assert len(wrong) > 200
    assert not {module: names for module, names in wrong.items() if names}


def test_core_reaches_nothing_outside_itself() -> None:
    """No clock, no generator but one passed in, no I/O: below `assembly`, time and randomness are arguments."""
    wrong = {}
    for module in MODULES:
        if package_of(name_of(module)) in WITHOUT_CLOCKS or str(module) in PURE_NETEM | EQUATIONS_OF_MANY:
            may_read = READS_FILES.keys() & {module.as_posix(), module.parent.as_posix()}
            found = reached((ROOT / module).read_text("utf-8"), name_of(module), module.name == "__init__.py")
            found -= FILES | {"open"} if may_read else set()
            wrong[module] = found - REACHES_OUT.get(module.as_posix(), set())
    assert len(wrong) > 150
    assert not {module: names for module, names in wrong.items() if names}


def reached(source: str, module: str, is_package: bool = False) -> set[str]:
    """What of clocks, files and generators a module uses: imported modules, `open`, functions of numpy.random."""
    names = set(imports(source, module, is_package))
    tree = nodes(source)
    dotted = {
        f"numpy.random.{part.attr}"
        for part in tree
        if isinstance(part, ast.Attribute) and isinstance(part.value, ast.Attribute)
        if ast.unparse(part.value) in ("np.random", "numpy.random")
    }
    generators = {each for each in names | dotted if re.fullmatch(r"numpy\.random\.[a-z]\w*", each)}
    return roots(names) & (FILES | CLOCKS_AND_OTHERS) | called(source) & {"open", "input"} | generators


def test_every_way_out_is_seen() -> None:
    source = "import os.path\nfrom time import time\nx = np.random.default_rng(), open('f')\ny: np.random.Generator"
    assert reached(source, "p.q") == {"os", "time", "open", "numpy.random.default_rng"}
    assert reached("from numpy.random import rand, PCG64", "p.q") == {"numpy.random.rand"}


def test_equations_add_up_the_same_on_every_python() -> None:
    """Python's own `sum` rounds otherwise from 3.12 on; where it only counts, or asks for a NaN, it may stay."""
    equations = [m for m in MODULES if package_of(name_of(m)) in ADDS_UP or m.as_posix() in EQUATIONS_OF_MANY]
    found = {module.as_posix() for module in equations if "sum" in called((ROOT / module).read_text("utf-8"))}
    assert len(equations) > 80
    assert found == COUNTS


def called(source: str) -> set[str]:
    """Every function that is called by its bare name."""
    calls = [node.func for node in nodes(source) if isinstance(node, ast.Call)]
    return {function.id for function in calls if isinstance(function, ast.Name)}


def test_only_transport_knows_zenoh() -> None:
    knowing = {module.as_posix() for module in MODULES if "zenoh" in roots(imports_of(module))}
    assert {each for each in knowing if not each.startswith(("hapnet/transport/", "netem/"))} == set(OPENS_ZENOH)


def test_netem_knows_nothing_of_hapnet() -> None:
    of_netem = [module for module in MODULES if module.parts[0] == "netem"]
    assert len(of_netem) > 20
    assert not [module for module in of_netem if "hapnet" in roots(imports_of(module))]


def test_hapnet_itself_imports_its_public_names_only_for_type_checkers() -> None:
    """They are of core and extensions; when hapnet runs, each is imported when it is used."""
    for node in ast.parse((ROOT / "hapnet" / "__init__.py").read_text("utf-8")).body:
        if not isinstance(node, ast.If) or ast.unparse(node.test) != "TYPE_CHECKING":
            found = set(imports(ast.unparse(node), "hapnet", is_package=True))
            assert not [name for name in found if name.startswith("hapnet.") and package_of(name) != "base"]


def test_modules_stay_short() -> None:
    """Tests and examples too."""
    files = [path for folder in ("hapnet", "netem", "tests", "examples") for path in (ROOT / folder).rglob("*.py")]
    lengths = {str(path.relative_to(ROOT)): len(path.read_text("utf-8").splitlines()) for path in files}
    assert len(lengths) > 400
    assert not {name: length for name, length in lengths.items() if length > MAX_LENGTH}


def test_few_modules_are_tiny() -> None:
    """A module of fewer lines joins a neighbour that is about the same; at most so many of hapnet's stand alone."""
    modules = [module for module in MODULES if module.parts[0] == "hapnet" and module.name != "__init__.py"]
    short = [str(module) for module in modules if len((ROOT / module).read_text("utf-8").splitlines()) < SHORT]
    assert len(modules) > 300
    assert len(short) <= MOST_SHORT, short


def test_nobody_asks_for_a_coupling_by_its_name() -> None:
    """What a coupling is or needs is said by its `CouplingSpec`."""
    for module in [module for module in MODULES if module.parts[0] == "hapnet"]:
        tree = nodes((ROOT / module).read_text("utf-8"))
        asked = [part for part in tree if isinstance(part, ast.Compare)]
        constants = [part for each in asked for part in ast.walk(each) if isinstance(part, ast.Constant)]
        assert not [(part.lineno, part.value) for part in constants if part.value in COUPLING_NAMES], module


def attributes_of(source: str) -> Iterator[tuple[ast.ClassDef, set[str]]]:
    """Every class of a module with the names that it declares, or sets on `self`."""
    for node in nodes(source):
        if isinstance(node, ast.ClassDef):
            declared = {
                line.target.id
                for line in node.body
                if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name)
            }
            yield (
                node,
                declared
                | {
                    part.attr
                    for part in ast.walk(node)
                    if isinstance(part, ast.Attribute) and isinstance(part.ctx, ast.Store)
                    if isinstance(part.value, ast.Name) and part.value.id == "self"
                },
            )


def test_all_attributes_of_a_class_are_seen() -> None:
    source = "class A:\n    a: int\n    def f(self):\n        self.b, other.c = self.d = self.e[0] = 1"
    assert [(node.name, found) for node, found in attributes_of(source)] == [("A", {"a", "b", "d"})]


def test_a_class_of_many_attributes_says_why() -> None:
    for module in MODULES:
        for node, found in attributes_of((ROOT / module).read_text("utf-8")):
            # a record of the kernel has the state of several objects: nobody but compiled code looks at it
            if len(found) > MOST_ATTRIBUTES and "Record" not in map(ast.unparse, node.bases):
                assert "More than twenty attributes:" in (ast.get_docstring(node) or ""), (node.name, len(found))


BY_NAME = {
    "hapnet/ext/doctor/machine.py": "sys tells so whether there is a lock, from Python 3.13 on",
}
"""Modules that name attributes which are private to others, and why."""


def test_nobody_reaches_private_attributes_by_their_names() -> None:
    """The linter sees `other._name`; it does not see names in strings, or names that are put together."""
    found = {}
    for module in MODULES:
        source = (ROOT / module).read_text("utf-8")
        for node in nodes(source):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
                called = node.func.id if isinstance(node.func, ast.Name) else node.func.attr
                if called in {"getattr", "setattr", "hasattr", "delattr", "attrgetter", "__getattribute__"}:
                    strings = [part.value for one in node.args for part in ast.walk(one)
                               if isinstance(part, ast.Constant) and isinstance(part.value, str)]  # fmt: skip
                    if any(re.match(r"_(?!_)", text) for text in strings):
                        found[str(module)] = ast.unparse(node)
        if re.search(r"\(\w+, \"_[a-z]\w*\", ", source):  # a table of such names
            found.setdefault(str(module), "a table of names")
    assert found.keys() == BY_NAME.keys(), found


ASKS_WHAT_IT_GOT = {
    "hapnet/ext/engines/own_worlds.py": "makes a user's world a whole one",
    "hapnet/plant/worlds/protocol.py": "the same, of any part",
    "hapnet/ext/engines/engine_account.py": "names the method of an engine that failed",
    "hapnet/plant/operator.py": "an operator may give many points at once",
    "hapnet/assembly/build.py": "reads parameters by their names",
    "hapnet/ext/tools/posed.py": "makes a user's device one that turns",
    "hapnet/ext/arms/parameters.py": "reads parameters by their names",
}
"""Modules that ask a part what it has, of those that know worlds: everyone else has protocols with defaults."""

KNOW_WORLDS = {"mechanics", "plant", *(f"ext.{name}" for name in ("solids", "engines", "soft", "tools", "arms"))}
ALSO = {"world.py", "set_position_coupling.py", "build.py"}


def test_nobody_asks_a_world_what_it_has() -> None:
    know = [each for each in MODULES if package_of(name_of(each)) in KNOW_WORLDS or each.name in ALSO]
    asking = {each.as_posix() for each in know if {"getattr", "hasattr"} & called((ROOT / each).read_text("utf-8"))}
    assert asking == ASKS_WHAT_IT_GOT.keys()


STARTS_PROCESSES = {
    "hapnet/processes": "all others ask it",
    "netem/bench.py": "it knows nothing of hapnet",
    "hapnet/transport/security.py": "openssl makes the keys",
}
"""Who starts programs, or children that run a function, and why."""


def test_one_package_starts_child_processes() -> None:
    for module in MODULES:
        if not {module.as_posix(), module.parent.as_posix()} & STARTS_PROCESSES.keys():
            assert not roots(imports_of(module)) & {"subprocess", "multiprocessing"}, module
            assert "create_subprocess" not in (ROOT / module).read_text("utf-8"), module


def test_one_package_draws() -> None:
    """Nobody else touches matplotlib, but to say what a figure is."""
    drawing = {
        module for module in MODULES if module.parts[0] == "hapnet" and "matplotlib" in roots(imports_of(module))
    }
    for module in drawing - {each for each in drawing if each.parts[:3] == ("hapnet", "ext", "pictures")}:
        assert {name for name in imports_of(module) if name.startswith("matplotlib")} == {
            "matplotlib.figure", "matplotlib.figure.Figure"
        }, module  # fmt: skip
    assert len(drawing) > 10
