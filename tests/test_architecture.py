"""The house rules that a machine can read: who may import whom, and who may not import what."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import twohands

PACKAGE = Path(twohands.__file__).parent

STOREYS = [
    {"types", "skeleton", "errors", "files", "formats", "plausibility", "version"},
    {"geometry"},
    {"synth", "datasets", "models", "evaluation"},
    {"training", "inference", "peers"},
    {"visualization", "export", "lifting"},
    {"cli"},
]
"""Rooms from the ground up. A room may use itself and lower storeys, never its own storey's neighbours. The ground
floor is the exception: its modules may use each other."""
STOREY = {room: level for level, rooms in enumerate(STOREYS) for room in rooms}

SYNTH_ROOMS = {
    "backgrounds": set(),
    "production": set(),
    "scene": {"backgrounds"},
    "render": {"backgrounds", "scene"},
    "sets": {"backgrounds", "production", "scene", "render"},
}
"""Rooms of synth, and the others that each may use; every module of synth lives in one of them."""

EXTRAS = {
    "torch": {"models", "training", "export"},
    "lightning": {"training"},
    "lightning_fabric": {"training"},
    "safetensors": {"models", "training", "export"},
    "onnx": {"export"},
    "onnxscript": {"export"},
    "moderngl": {"synth"},
    "anny": {"synth"},
    "matplotlib": {"visualization"},
    "ray": set(),
    "av": set(),
}
"""Optional packages, and the rooms whose modules may need them to be imported; elsewhere only inside functions."""

GEOMETRY_NEEDS = {"numpy", "array_api_compat", "cv2"}
ONLY_CLI = {"argparse", "tyro"}


def modules(package: Path) -> list[Path]:
    return sorted(path for path in package.rglob("*.py"))


def imported(source: str, module: str, *, at_import_time_only: bool = False) -> set[str]:
    """Full dotted names a module imports; `module` is its own dotted name, to resolve relative imports.

    Imports under `if TYPE_CHECKING` count as well: they too tie rooms together. With `at_import_time_only`, function
    bodies and TYPE_CHECKING blocks are left out.
    """
    names: set[str] = set()

    def visit(node: ast.AST) -> None:
        if at_import_time_only:
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
                return
            if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
                return
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                base = ".".join([*module.split(".")[: -node.level], *filter(None, [base])])
            names.update(f"{base}.{alias.name}" for alias in node.names)
        for child in ast.iter_child_nodes(node):
            visit(child)

    visit(ast.parse(source))
    return names


def dotted_name(path: Path, package: Path) -> str:
    """Name of a module file; an `__init__.py` keeps that word as its last part, so that relative imports resolve."""
    return ".".join(path.relative_to(package.parent).with_suffix("").parts)


def rooms_used(source: str, module: str) -> set[str]:
    return {name.split(".")[1] for name in imported(source, module) if name.startswith("twohands.")}


def forbidden_rooms(source: str, module: str) -> set[str]:
    """Rooms a module imports against the direction of the house."""
    room = module.split(".")[1]
    return {
        other
        for other in rooms_used(source, module)
        if other in STOREY and other != room and STOREY[other] >= STOREY[room] and STOREY[room] > 0
    } | {other for other in rooms_used(source, module) if STOREY[room] == 0 and STOREY.get(other, 0) > 0}


def forbidden_synth_rooms(source: str, module: str) -> set[str]:
    """Other rooms of synth that a module of synth may not import, and its own place where that is none of them."""
    _, place, *rooms = module.split(".")
    if place != "synth" or rooms == ["__init__"]:
        return set()
    room = rooms[0]
    if room not in SYNTH_ROOMS or len(rooms) == 1:
        return {"in no room of synth"}
    parts = [name.split(".") for name in imported(source, module) if name.startswith("twohands.synth.")]
    return {part[2] for part in parts} - SYNTH_ROOMS[room] - {room}


def violations(package: Path, check) -> list[str]:
    """Every module inside a room for which `check(source, dotted name)` returns something."""
    found: list[str] = []
    for path in modules(package):
        module = dotted_name(path, package)
        if module.split(".")[1] in STOREY:
            found += [f"{module}: {what}" for what in sorted(check(path.read_text(encoding="utf-8"), module))]
    return found


def forbidden_extras(source: str, module: str) -> set[str]:
    roots = {name.split(".")[0] for name in imported(source, module, at_import_time_only=True)}
    return {root for root in roots if root in EXTRAS and module.split(".")[1] not in EXTRAS[root]}


def spoken(source: str, module: str) -> set[str]:
    """Things only the command line may do: print, and parse arguments. A module run as a script may speak as well."""
    if module.split(".")[1] == "cli":
        return set()
    body = [node for node in ast.parse(source).body if not ast.unparse(node).startswith("if __name__ == '__main__'")]
    nodes = [node for statement in body for node in ast.walk(statement)]
    calls = {"print" for node in nodes if isinstance(node, ast.Call) and ast.unparse(node.func) == "print"}
    return calls | {root for root in (name.split(".")[0] for name in imported(source, module)) if root in ONLY_CLI}


def geometry_strangers(source: str, module: str) -> set[str]:
    """Geometry is pure: numbers in, numbers out."""
    if module.split(".")[1] != "geometry":
        return set()
    roots = {name.split(".")[0] for name in imported(source, module)}
    files = roots & {"io", "os", "pathlib", "shutil", "tempfile", "subprocess", "socket", "urllib"}
    return files | {root for root in roots if root not in sys.stdlib_module_names | GEOMETRY_NEEDS | {"twohands"}}


def test_every_module_lives_in_a_known_room():
    unknown = {
        module
        for module in (dotted_name(path, PACKAGE) for path in modules(PACKAGE))
        if module.split(".")[1] not in {*STOREY, "__init__", "__main__"}
    }
    assert not unknown, "new rooms must be given a storey in this test"


@pytest.mark.parametrize(
    "check",
    [forbidden_rooms, forbidden_synth_rooms, forbidden_extras, spoken, geometry_strangers],
    ids=lambda check: check.__name__,
)
def test_house_rule(check):
    assert violations(PACKAGE, check) == []


def test_rooms_of_synth_stand_on_each_other():
    """At most ten arrows and no circle: rooms can be left one after the other, those that nobody needs first."""
    assert sum(map(len, SYNTH_ROOMS.values())) <= 10
    standing = dict(SYNTH_ROOMS)
    while standing:
        needed = set().union(*standing.values())
        tops = standing.keys() - needed
        assert tops, f"a circle among {sorted(standing)}"
        standing = {room: below for room, below in standing.items() if room not in tops}


@pytest.mark.parametrize(
    ("check", "path", "source", "expected"),
    [
        (forbidden_rooms, "geometry/a.py", "from twohands.models.blocks import X", ["twohands.geometry.a: models"]),
        (forbidden_rooms, "geometry/a.py", "def f():\n    import twohands.cli.main", ["twohands.geometry.a: cli"]),
        (forbidden_rooms, "geometry/a.py", "from ..synth import scene", ["twohands.geometry.a: synth"]),
        (forbidden_rooms, "geometry/__init__.py", "from ..synth import x", ["twohands.geometry.__init__: synth"]),
        (forbidden_rooms, "synth/render/b.py", "from ...datasets import x", ["twohands.synth.render.b: datasets"]),
        (forbidden_rooms, "synth/b.py", "from twohands import datasets", ["twohands.synth.b: datasets"]),
        (forbidden_rooms, "types.py", "import twohands.geometry.boxes", ["twohands.types: geometry"]),
        (forbidden_rooms, "types.py", "from twohands.errors import InputError", []),
        (forbidden_rooms, "cli/c.py", "from twohands.synth import x\nfrom . import y", []),
        (forbidden_rooms, "geometry/a.py", "from . import boxes\nfrom twohands.types import Array", []),
        (forbidden_synth_rooms, "synth/a.py", "", ["twohands.synth.a: in no room of synth"]),
        (forbidden_synth_rooms, "synth/attic/a.py", "", ["twohands.synth.attic.a: in no room of synth"]),
        (forbidden_synth_rooms, "synth/scene/a.py", "from ..render import x", ["twohands.synth.scene.a: render"]),
        (
            forbidden_synth_rooms,
            "synth/scene/a.py",
            "from twohands.synth import sets",
            ["twohands.synth.scene.a: sets"],
        ),
        (forbidden_synth_rooms, "synth/render/a.py", "from twohands.synth.scene.body import x", []),
        (forbidden_synth_rooms, "training/a.py", "from twohands.synth.sets import cache", []),
        (forbidden_extras, "inference/d.py", "import torch.nn", ["twohands.inference.d: torch"]),
        (forbidden_extras, "inference/d.py", "def f():\n    import torch", []),
        (forbidden_extras, "models/d.py", "import torch", []),
        (spoken, "models/e.py", "print(1)", ["twohands.models.e: print"]),
        (spoken, "models/e.py", "if __name__ == '__main__':\n    print(1)", []),
        (spoken, "models/e.py", "import argparse", ["twohands.models.e: argparse"]),
        (spoken, "cli/e.py", "import tyro\nprint(1)", []),
        (geometry_strangers, "geometry/f.py", "import scipy", ["twohands.geometry.f: scipy"]),
        (geometry_strangers, "geometry/f.py", "from pathlib import Path", ["twohands.geometry.f: pathlib"]),
        (geometry_strangers, "geometry/f.py", "import math, numpy, cv2", []),
    ],
)
def test_the_rules_can_be_broken(tmp_path, check, path, source, expected):
    """Each rule, tried on a house with one module."""
    file = tmp_path / "twohands" / path
    file.parent.mkdir(parents=True)
    file.write_text(source, encoding="utf-8")
    assert violations(tmp_path / "twohands", check) == expected


def test_import_is_light():
    """`import twohands` loads none of the heavy packages: the first answer of a command must not wait for them."""
    heavy = ["torch", "cv2", "openvino", "matplotlib", "moderngl", "tyro"]
    program = f"import sys, twohands; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
