"""The house rules that a machine can read: who may import whom, and who may not import what."""

from __future__ import annotations

import ast
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

import twohands

PACKAGE = Path(twohands.__file__).parent
ROOT = Path(__file__).parents[1]

STOREYS = [
    {"types", "skeleton", "errors", "files", "formats", "plausibility", "version", "executors"},
    {"geometry"},
    {"synth", "datasets", "models", "evaluation"},
    {"training", "inference", "peers"},
    {"visualization", "export", "lifting", "calibration", "studies", "motion"},
    {"live", "batch"},
    {"cli"},
]
"""Rooms from the ground up. A room may use itself and lower storeys, never its own storey's neighbours. The ground
floor is the exception: its modules may use each other."""
STOREY = {room: level for level, rooms in enumerate(STOREYS) for room in rooms}

APART = {"inference": {"evaluation", "synth", "datasets", "models"}}
"""Rooms of lower storeys that a room may not use all the same: what runs at a user's measures, renders and trains
nothing."""

FLOOR = ""
SUB_ROOMS = {
    "synth": {
        "backgrounds": set(),
        "production": set(),
        "scene": {"backgrounds"},
        "render": {"backgrounds", "scene"},
        "sets": {"backgrounds", "production", "scene", "render"},
    },
    "datasets": {FLOOR: set(), "inspection": {FLOOR}},
    "cli": {FLOOR: set(), "eval": {FLOOR}},
}
"""Rooms within rooms, and the others of the same room that each may use; FLOOR are modules in none of them."""

PROGRAMS = {"scripts": {"tests.fuzz"}, "benchmarks": {"tests.builders"}}
"""Folders of programs, and what of the tests each may use. They stand on the package, and nothing stands on them."""

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
    "starlette": {"live"},
    "uvicorn": {"live"},
    "websockets": set(),
    "fsspec": set(),
    "pygltflib": set(),
    "rosbags": set(),
    "pythonosc": set(),
}
"""Optional packages, and the rooms whose modules may need them to be imported; elsewhere only inside functions."""

GEOMETRY_NEEDS = {"numpy", "array_api_compat", "cv2"}
ONLY_CLI = {"argparse", "tyro", "rich"}
STREAMS = {"sys.stdout", "sys.stderr", "sys.__stdout__", "sys.__stderr__"}
SPEAKERS = {"twohands.peers.mediapipe_worker", "twohands.synth.render.blender"}
"""Modules that must touch the standard streams: a program whose answers are lines, and the one that keeps Blender's
words off them."""


def modules(package: Path) -> list[Path]:
    return sorted(path for path in package.rglob("*.py"))


@cache
def tree(source: str) -> ast.Module:
    """A module's syntax, which many rules look at."""
    return ast.parse(source)


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

    visit(tree(source))
    return names


def dotted_name(path: Path, package: Path) -> str:
    """Name of a module file; an `__init__.py` keeps that word as its last part, so that relative imports resolve."""
    return ".".join(path.relative_to(package.parent).with_suffix("").parts)


def room_of(module: str) -> str:
    """The room of a module of the package; that of `twohands/__init__.py` and `__main__.py` is no room."""
    return module.split(".")[1]


def rooms_used(source: str, module: str) -> set[str]:
    return {name.split(".")[1] for name in imported(source, module) if name.startswith("twohands.")}


def forbidden_rooms(source: str, module: str) -> set[str]:
    """Rooms a module imports against the direction of the house."""
    room = room_of(module)
    if room not in STOREY:
        return set()
    used = {other for other in rooms_used(source, module) if other in STOREY and other != room}
    return {other for other in used if STOREY[other] > STOREY[room] or STOREY[other] == STOREY[room] > 0} | (
        used & APART.get(room, set())
    )


def front_door(source: str, module: str) -> set[str]:
    """Public names of the package itself, which would bring along whatever room they live in."""
    if room_of(module) not in STOREY:
        return set()
    names = {name for name in imported(source, module) if name.split(".")[0] == "twohands"}
    return {name for name in names if name == "twohands" or name.split(".")[1] not in STOREY}


def forbidden_sub_rooms(source: str, module: str) -> set[str]:
    """Other rooms of the same room that a module may not import, and its own place where that is none of them."""
    room = room_of(module)
    if room not in SUB_ROOMS or module == f"twohands.{room}.__init__":
        return set()
    allowed = SUB_ROOMS[room]

    def place(parts: list[str]) -> str:
        return parts[2] if len(parts) > 3 or parts[2] in allowed else FLOOR

    own = place(module.split("."))
    if own not in allowed:
        return {f"in no room of {room}"}
    used = {place(name.split(".")) for name in imported(source, module) if name.startswith(f"twohands.{room}.")}
    return {other or "the floor" for other in used & allowed.keys() - allowed[own] - {own}}


def private_names(source: str, module: str) -> set[str]:
    """Names with a leading underscore of other rooms."""
    home = ".".join(module.split(".")[:2]) + "."
    names = {name for name in imported(source, module) if name.startswith("twohands.") and not name.startswith(home)}
    return {name for name in names if any(part[0] == "_" != part[1] for part in name.split("."))}


def program_strangers(source: str, module: str) -> set[str]:
    """What a program imports of our own beside the package and its own folder."""
    folder = module.split(".")[0]
    names = {name for name in imported(source, module) if name.split(".")[0] in {"tests", *PROGRAMS} - {folder}}
    return {name for name in names if not any(name.startswith(f"{part}.") for part in PROGRAMS.get(folder, ()))}


def violations(folder: Path, check) -> list[str]:
    """Every module below a folder for which `check(source, dotted name)` returns something."""
    found: list[str] = []
    for path in modules(folder):
        module = dotted_name(path, folder)
        found += [f"{module}: {what}" for what in sorted(check(path.read_text(encoding="utf-8"), module))]
    return found


def forbidden_extras(source: str, module: str) -> set[str]:
    roots = {name.split(".")[0] for name in imported(source, module, at_import_time_only=True)}
    return {root for root in roots if root in EXTRAS and room_of(module) not in EXTRAS[root]}


def spoken(source: str, module: str) -> set[str]:
    """Things only the command line may do: print, write to the standard streams, and parse arguments. A module run as a
    script may speak as well."""
    if room_of(module) in ("cli", "__main__"):
        return set()
    body = [
        node for node in tree(source).body if not (isinstance(node, ast.If) and "__main__" in ast.unparse(node.test))
    ]
    nodes = [node for statement in body for node in ast.walk(statement)]
    called = {node.func.id for node in nodes if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)}
    found = called & {"print"}
    if module not in SPEAKERS:
        ends = {stream.rpartition(".")[2] for stream in STREAMS}
        streams = [node for node in nodes if isinstance(node, ast.Attribute) and node.attr in ends]
        found |= {ast.unparse(node) for node in streams} & STREAMS
        found |= imported(source, module) & STREAMS
    return found | {root for root in (name.split(".")[0] for name in imported(source, module)) if root in ONLY_CLI}


def too_long(source: str, module: str) -> set[str]:
    """Lines of a module with more than one job can have: 450, and 120 for a verb of eval."""
    lines, most = len(source.splitlines()), 120 if module.startswith("twohands.cli.eval.") else 450
    return {f"{lines} lines, at most {most}"} if lines > most else set()


def geometry_strangers(source: str, module: str) -> set[str]:
    """Geometry is pure: numbers in, numbers out."""
    if room_of(module) != "geometry":
        return set()
    roots = {name.split(".")[0] for name in imported(source, module)}
    files = roots & {"io", "os", "pathlib", "shutil", "tempfile", "subprocess", "socket", "urllib"}
    return files | {root for root in roots if root not in sys.stdlib_module_names | GEOMETRY_NEEDS | {"twohands"}}


def test_every_module_lives_in_a_known_room():
    unknown = {
        module
        for module in (dotted_name(path, PACKAGE) for path in modules(PACKAGE))
        if room_of(module) not in {*STOREY, "__init__", "__main__"}
    }
    assert not unknown, "new rooms must be given a storey in this test"


PACKAGE_RULES = [
    *(forbidden_rooms, front_door, forbidden_sub_rooms, private_names, program_strangers),
    *(forbidden_extras, spoken, geometry_strangers, too_long),
]


@pytest.mark.parametrize("check", PACKAGE_RULES, ids=lambda check: check.__name__)
def test_house_rule(check):
    assert violations(PACKAGE, check) == []


@pytest.mark.parametrize("check", [private_names, program_strangers], ids=lambda check: check.__name__)
@pytest.mark.parametrize("folder", PROGRAMS)
def test_programs_use_what_the_package_shows(folder: str, check):
    assert modules(ROOT / folder), f"{folder}: no programs"
    assert violations(ROOT / folder, check) == []


def names_of(path: Path) -> set[str]:
    """Names at the top of a module, of modules beside it where it is a package's, and what it imports."""
    found = {each.stem for each in path.parent.iterdir()} if path.name == "__init__.py" else set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            found |= {alias.asname or alias.name for alias in node.names}
    return found


@pytest.mark.parametrize("folder", PROGRAMS)
def test_programs_import_what_is_there(folder: str):
    """Named case: benchmarks/soak.py imported a function that had moved; no test runs it."""
    absent = []
    for path in modules(ROOT / folder):
        for name in imported(path.read_text(encoding="utf-8"), dotted_name(path, ROOT / folder)):
            parts = name.split(".")
            home = PACKAGE.parent.joinpath(*parts[:-1])
            file = next((each for each in (home.with_suffix(".py"), home / "__init__.py") if each.is_file()), None)
            if parts[0] == "twohands" and len(parts) > 1 and (file is None or parts[-1] not in names_of(file)):
                absent.append(f"{path.relative_to(ROOT)}: {name}")
    assert not absent


def test_sub_rooms_are_those_that_are_there():
    """Every folder with modules within a room is given its place here, and none that is not there."""
    folders = {(path.parent.parent.name, path.parent.name) for path in PACKAGE.glob("*/*/*.py")}
    listed = {(room, sub) for room, subs in SUB_ROOMS.items() for sub in subs if sub != FLOOR}
    assert folders == listed


@pytest.mark.parametrize("room", SUB_ROOMS)
def test_rooms_within_a_room_stand_on_each_other(room: str):
    """At most ten arrows and no circle: rooms can be left one after the other, those that nobody needs first."""
    assert sum(map(len, SUB_ROOMS[room].values())) <= 10
    standing = dict(SUB_ROOMS[room])
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
        (forbidden_rooms, "inference/a.py", "import twohands.evaluation.metrics", ["twohands.inference.a: evaluation"]),
        (
            front_door,
            "geometry/a.py",
            "from twohands import HandEstimator",
            ["twohands.geometry.a: twohands.HandEstimator"],
        ),
        (front_door, "geometry/a.py", "def f():\n    from .. import lift", ["twohands.geometry.a: twohands.lift"]),
        (front_door, "cli/a.py", "import twohands", ["twohands.cli.a: twohands"]),
        (front_door, "geometry/a.py", "from twohands import types", []),
        (front_door, "__main__.py", "from twohands import lift", []),
        (forbidden_rooms, "cli/c.py", "from twohands.synth import x\nfrom . import y", []),
        (forbidden_rooms, "geometry/a.py", "from . import boxes\nfrom twohands.types import Array", []),
        (forbidden_sub_rooms, "synth/a.py", "", ["twohands.synth.a: in no room of synth"]),
        (forbidden_sub_rooms, "synth/attic/a.py", "", ["twohands.synth.attic.a: in no room of synth"]),
        (forbidden_sub_rooms, "synth/scene/a.py", "from ..render import x", ["twohands.synth.scene.a: render"]),
        (
            forbidden_sub_rooms,
            "synth/scene/a.py",
            "from twohands.synth import sets",
            ["twohands.synth.scene.a: sets"],
        ),
        (forbidden_sub_rooms, "synth/render/a.py", "from twohands.synth.scene.body import x", []),
        (forbidden_sub_rooms, "training/a.py", "from twohands.synth.sets import cache", []),
        (
            forbidden_sub_rooms,
            "datasets/a.py",
            "from .inspection import inspect",
            ["twohands.datasets.a: inspection"],
        ),
        (forbidden_sub_rooms, "datasets/inspection/a.py", "from twohands.datasets.base import HandDataset", []),
        (forbidden_sub_rooms, "datasets/attic/a.py", "", ["twohands.datasets.attic.a: in no room of datasets"]),
        (forbidden_sub_rooms, "cli/track.py", "from twohands.cli import eval", ["twohands.cli.track: eval"]),
        (forbidden_sub_rooms, "cli/eval/a.py", "from twohands.cli.output import write_file", []),
        (
            private_names,
            "cli/a.py",
            "from twohands.geometry.boxes import _x",
            ["twohands.cli.a: twohands.geometry.boxes._x"],
        ),
        (private_names, "geometry/a.py", "from twohands.geometry._arrays import namespace", []),
        (private_names, "cli/a.py", "from twohands.version import __version__", []),
        (program_strangers, "cli/a.py", "from benchmarks import real_hands", ["twohands.cli.a: benchmarks.real_hands"]),
        (program_strangers, "cli/a.py", "from tests.builders import x", ["twohands.cli.a: tests.builders.x"]),
        (forbidden_extras, "inference/d.py", "import torch.nn", ["twohands.inference.d: torch"]),
        (forbidden_extras, "inference/d.py", "def f():\n    import torch", []),
        (forbidden_extras, "models/d.py", "import torch", []),
        (spoken, "models/e.py", "print(1)", ["twohands.models.e: print"]),
        (spoken, "models/e.py", "if __name__ == '__main__':\n    print(1)", []),
        (spoken, "models/e.py", "import argparse", ["twohands.models.e: argparse"]),
        (spoken, "models/e.py", "from rich import print", ["twohands.models.e: rich"]),
        (spoken, "models/e.py", "def f():\n    from rich.console import Console", ["twohands.models.e: rich"]),
        (spoken, "models/e.py", "import sys\nsys.stdout.write('1')", ["twohands.models.e: sys.stdout"]),
        (spoken, "models/e.py", "from sys import stderr", ["twohands.models.e: sys.stderr"]),
        (spoken, "cli/e.py", "import tyro\nprint(1)", []),
        (too_long, "geometry/e.py", "x = 1\n" * 451, ["twohands.geometry.e: 451 lines, at most 450"]),
        (too_long, "geometry/e.py", "x = 1\n" * 450, []),
        (too_long, "cli/eval/e.py", "x = 1\n" * 121, ["twohands.cli.eval.e: 121 lines, at most 120"]),
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


@pytest.mark.parametrize(
    ("check", "source", "expected"),
    [
        (program_strangers, "from benchmarks.real_hands import x", ["scripts.a: benchmarks.real_hands.x"]),
        (program_strangers, "from tests.oracles import x", ["scripts.a: tests.oracles.x"]),
        (program_strangers, "from tests.fuzz.mutations import KINDS", []),
        (program_strangers, "from scripts import fuzz\nimport twohands", []),
        (private_names, "from twohands.geometry.boxes import _x", ["scripts.a: twohands.geometry.boxes._x"]),
    ],
)
def test_the_rules_of_programs_can_be_broken(tmp_path, check, source, expected):
    """The same for a script."""
    (tmp_path / "scripts").mkdir()
    (tmp_path / "scripts" / "a.py").write_text(source, encoding="utf-8")
    assert violations(tmp_path / "scripts", check) == expected


def test_import_is_light():
    """`import twohands` loads none of the heavy packages: the first answer of a command must not wait for them."""
    heavy = ["torch", "cv2", "openvino", "matplotlib", "moderngl", "tyro"]
    program = f"import sys, twohands; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
