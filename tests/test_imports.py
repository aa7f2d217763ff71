"""One-way imports: every arrow points back along the way that data flows, and few modules know of Mitsuba."""

from __future__ import annotations

import ast
import graphlib
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

SOURCE = Path(__file__).parent.parent / "raytrace2"

# Earlier rows never import later ones. A module belongs to the longest name here that it or a folder of it bears;
# modules of one row may import each other, in one direction. Rays are met by surfaces, so the ray itself comes before
# the cameras that make rays; the scene that is traced comes after everything that it is put together from.
LAYERS = (
    ("errors",),
    ("arguments",),
    ("_llvm",),
    ("types",),
    ("files", "exr_header", "exr", "image_io"),
    ("packets", "buffers", "warp", "chances", "live", "reachable", "fixed_order", "private_sums"),
    ("scene",),  # the description and its readers
    ("rays.ray",),
    ("surfaces",),
    ("accel",),
    ("rays",),
    ("textures",),
    ("materials",),
    ("lights",),
    ("parameters.coercion", "parameters.fields", "parameters.store"),
    ("scene.scene", "scene.traced", "scene.procedural"),
    ("parameters",),
    ("reconstruction", "film"),
    ("integrators",),
    ("filtering", "render_arguments"),
    ("job",),
    ("boundary",),
    ("differentiable",),
    ("render",),
    ("box_edges", "box_cuts", "picture_parts"),
    ("load", "provenance", "notebook", "structure_pictures"),
    ("reference",),
    ("compare",),
    ("tradeoff", "stability"),
    ("mitsuba_plugins", "distributed"),
    ("__init__",),
    ("doctor",),
    ("commands",),
    ("cli",),
    ("__main__",),
)
LAYER_OF = {name: number for number, names in enumerate(LAYERS) for name in names}

# The scene readers, the reference renders and our plugins inside Mitsuba.
KNOWS_MITSUBA = ("scene", "reference", "mitsuba_plugins")
TRACES = (
    "rays", "surfaces", "accel", "textures", "materials", "lights", "integrators", "scene.scene", "scene.traced",
    "film",
)  # fmt: skip


def modules() -> dict[str, Path]:
    """Every module by its name below raytrace2, the package itself being ``__init__``."""
    found = {}
    for path in sorted(SOURCE.rglob("*.py")):
        name = ".".join(path.relative_to(SOURCE).with_suffix("").parts)
        found[name.removesuffix(".__init__")] = path
    return found


def imports(name: str, path: Path) -> set[str]:
    """Absolute names of what the file imports anywhere in it, ``import_module("...")`` included."""
    return set(named(ast.walk(ast.parse(path.read_text())), name, path))


def on_first_run(path: Path) -> Iterator[ast.AST]:
    """The nodes that run when the module does: none in functions, none under ``if TYPE_CHECKING``."""
    waiting: list[ast.AST] = [ast.parse(path.read_text())]
    while waiting:
        node = waiting.pop()
        yield node
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            waiting += node.orelse
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            waiting += ast.iter_child_nodes(node)


def named(nodes: Iterable[ast.AST], name: str, path: Path) -> Iterator[str]:
    """Absolute names of the modules, or of the things in modules, that import statements and calls among them name."""
    package = ["raytrace2", *name.split(".")]
    package = package[:-1] if path.name != "__init__.py" or name == "__init__" else package
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            base = [*base, *(node.module.split(".") if node.module else [])]
            yield from (".".join([*base, alias.name]) for alias in node.names)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute | ast.Name):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id
            if called in ("import_module", "__import__") and isinstance(node.args[0], ast.Constant):
                yield str(node.args[0].value)


def ours(nodes: Iterable[ast.AST], name: str, path: Path) -> set[str]:
    """Which of our modules those nodes import, by their names below raytrace2."""
    found = set()
    for target in named(nodes, name, path):
        if target.partition(".")[0] == "raytrace2":
            inside = target.partition(".")[2]
            while inside and inside not in ALL:  # the last part is a name in a module
                inside = inside.rpartition(".")[0]
            found.add(inside or "__init__")
    return found - {name}


def entry(name: str) -> str | None:
    while name and name not in LAYER_OF:
        name = name.rpartition(".")[0]
    return name or None


ALL = modules()
GRAPH = {name: ours(ast.walk(ast.parse(path.read_text())), name, path) for name, path in ALL.items()}


def test_every_module_has_a_layer() -> None:
    assert [name for name in GRAPH if entry(name) is None] == []


@pytest.mark.parametrize("name", GRAPH)
def test_no_arrow_runs_back(name: str) -> None:
    own = LAYER_OF[entry(name) or name]
    back = [target for target in sorted(GRAPH[name]) if LAYER_OF[entry(target) or target] > own]
    assert back == [], f"raytrace2.{name} imports {back}, which come after it in the order of LAYERS"


def test_no_circle() -> None:
    """Nothing is imported, when modules are first run, by what it imports itself."""
    graph = {name: ours(on_first_run(path), name, path) for name, path in ALL.items()}
    list(graphlib.TopologicalSorter(graph).static_order())


@pytest.mark.parametrize("name", GRAPH)
def test_only_readers_and_references_import_mitsuba(name: str) -> None:
    if (entry(name) or name) not in KNOWS_MITSUBA:
        tops = {target.partition(".")[0] for target in imports(name, ALL[name])}
        assert "mitsuba" not in tops


@pytest.mark.parametrize("name", [name for name in GRAPH if (entry(name) or name).startswith(TRACES)])
def test_tracing_code_stands_on_drjit_and_numpy_alone(name: str) -> None:
    tops = {target.partition(".")[0] for target in imports(name, ALL[name])}
    assert tops - set(sys.stdlib_module_names) <= {"raytrace2", "drjit", "numpy", "tqdm"}


def test_importing_the_package_leaves_mitsuba_out() -> None:
    code = "import sys, raytrace2; sys.exit('mitsuba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=SOURCE.parent, check=False).returncode == 0


def test_a_wrong_arrow_is_seen(tmp_path: Path) -> None:
    file = tmp_path / "ray.py"
    file.write_text(
        "def f():\n    from ..surfaces import mesh\n    import importlib\n    importlib.import_module('mitsuba')\n"
    )
    assert imports("rays.ray", file) == {"raytrace2.surfaces.mesh", "importlib", "mitsuba"}
