"""Lay faults into a copy of the code, and print which of them no test notices.

    make mutants N=5 SEED=7             N faults in every room, drawn by chance
    make mutants LIST=tests/mutants.jsonl   those of a list

A fault is one change of the syntax tree of one function: a comparison is turned round, plus becomes minus, a negation
is dropped, a constant is another one. The tests are those that lead to the function, by what they import and what that
uses and by their names, and then all replays. A fault that none of them notices may be harmless: look at it.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from queue import Queue
from typing import NamedTuple

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
REPLAYS = "tests/test_replays.py"
_FOLDERS = ("src", "lab/src", "tests", "lab/tests")
_WORKERS = 2
_MAX_DISTANCE = 9
_FLIPPED = {
    **{ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq},
    **{ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In},
}
_SWAPPED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
_UNTOUCHED = (ast.Raise, ast.JoinedStr, ast.Assert, ast.arguments)  # messages, and what is no code of the body


class Fault(NamedTuple):
    """A place of a function, named as in its module (`Pose.compose`): the `nth` one whose text is `before`."""

    module: str
    function: str
    before: str
    nth: int = 0


class Definition(NamedTuple):
    """What stands at the top of a module under a name."""

    module: str
    name: str


class Module(NamedTuple):
    """A file's definitions by name, and the local names of what it imports from other modules."""

    path: Path
    tree: ast.Module
    defined: dict[str, ast.AST]
    imported: dict[str, Definition]


# --- faults -----------------------------------------------------------------------------------------------------------


def with_fault(node: ast.AST) -> ast.AST | None:
    """A node with a fault in it; None if it is none of those that get one."""
    match node:
        case ast.Compare(ops=[op]) if type(op) in _FLIPPED:
            return ast.Compare(node.left, [_FLIPPED[type(op)]()], node.comparators)
        case ast.BinOp(op=op) if type(op) in _SWAPPED and not any(map(_is_text, (node.left, node.right))):
            return ast.BinOp(node.left, _SWAPPED[type(op)](), node.right)
        case ast.AugAssign(op=op) if type(op) in _SWAPPED and not _is_text(node.value):
            return ast.AugAssign(node.target, _SWAPPED[type(op)](), node.value)
        case ast.UnaryOp(op=ast.USub() | ast.Not()):
            return node.operand
        case ast.Constant(value=float()):
            return ast.Constant(2.0 * node.value + 1.0)
    return None


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.JoinedStr | ast.List | ast.Tuple) or isinstance(getattr(node, "value", None), str)


def sites(function: ast.AST) -> Iterator[ast.AST]:
    """The nodes of a function that can get a fault, in order."""
    children = function.body if isinstance(function, ast.FunctionDef) else ast.iter_child_nodes(function)
    for child in children:
        if not isinstance(child, _UNTOUCHED):
            if with_fault(child) is not None:
                yield child
            yield from sites(child)


def functions(tree: ast.AST, prefix: str = "") -> Iterator[tuple[str, ast.FunctionDef]]:
    """Functions and methods with their names, those inside of others not among them."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("__re"):
            yield prefix + node.name, node
        elif isinstance(node, ast.ClassDef):
            yield from functions(node, f"{prefix}{node.name}.")


class _Laid(ast.NodeTransformer):
    def __init__(self, place: ast.AST) -> None:
        self.place = place

    def visit(self, node: ast.AST) -> ast.AST:
        return with_fault(node) or node if node is self.place else self.generic_visit(node)


def laid(fault: Fault, text: str) -> tuple[str, str] | None:
    """The text of a module with a fault in it, and what the fault is; None if the code has changed there."""
    tree = ast.parse(text)
    function = dict(functions(tree)).get(fault.function)
    places = [] if function is None else [each for each in sites(function) if ast.unparse(each) == fault.before]
    if fault.nth >= len(places):
        return None
    place = places[fault.nth]
    change = f"line {getattr(place, 'lineno', 0)}: {fault.before} -> {ast.unparse(with_fault(place) or place)}"
    return ast.unparse(ast.fix_missing_locations(_Laid(place).visit(tree))), " ".join(change.split())


def rooms() -> list[str]:
    """Dotted names of the rooms, from the contracts of pyproject.toml."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"][
        "contracts"
    ]
    layered = [each for each in contracts if each["type"] == "layers"]
    return [
        f"{each['containers'][0]}.{room}" for each in layered for layer in each["layers"] for room in layer.split(" | ")
    ]


def room_of(module: str) -> str:
    """The innermost room that a module stands in; empty if it stands in none."""
    return max((room for room in rooms() if f"{module}.".startswith(f"{room}.")), key=len, default="")


def drawn(count: int, seed: int) -> list[Fault]:
    """Faults in `count` functions of every room. The same seed draws the same ones in the same code."""
    possible: dict[str, list[tuple[str, str, list[str]]]] = defaultdict(list)
    for name, module in modules().items():
        if room := room_of(name):
            for function, node in functions(module.tree):
                if texts := [ast.unparse(each) for each in sites(node)]:
                    possible[room].append((name, function, texts))
    faults = []
    for room, places in possible.items():
        rng = random.Random(f"{seed} {room}")
        for name, function, texts in rng.sample(places, min(count, len(places))):
            site = rng.randrange(len(texts))
            faults.append(Fault(name, function, texts[site], texts[:site].count(texts[site])))
    return faults


def listed(path: Path) -> list[Fault]:
    """The faults of a list, one JSON object a line."""
    return [Fault(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]


# --- tests that lead to a function ------------------------------------------------------------------------------------


@cache
def modules() -> dict[str, Module]:
    """Those of the packages, by their dotted names, and those of the tests."""
    found = {}
    for folder in _FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            name = ".".join(path.relative_to(ROOT / folder).with_suffix("").parts).removesuffix(".__init__")
            tree = ast.parse(path.read_text(encoding="utf-8"))
            calls = [node for node in tree.body if isinstance(node, ast.Expr)]  # as of a command that joins the others
            defined: dict[str, ast.AST] = {"": ast.Module(body=calls, type_ignores=[])}
            for node in tree.body:
                if isinstance(node, ast.FunctionDef | ast.ClassDef):
                    defined[node.name] = node
                elif isinstance(node, ast.Assign | ast.AnnAssign):
                    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                    defined |= {each.id: node for each in targets if isinstance(each, ast.Name)}
            imported = {
                alias.asname or alias.name: Definition(node.module or "", alias.name)
                for node in ast.walk(tree)
                if isinstance(node, ast.ImportFrom)
                for alias in node.names
            }
            found[name] = Module(path, tree, defined, imported)
    return found


def _origin(of: Definition) -> Definition:
    """Where a name is defined that a module may only pass on."""
    for _ in range(5):
        module = modules().get(of.module)
        if module is None or of.name in module.defined or of.name not in module.imported:
            break
        of = module.imported[of.name]
    return of


def _parts(of: Definition) -> list[Definition]:
    """All definitions of a module that is imported whole; else the one."""
    whole = f"{of.module}.{of.name}"
    return [Definition(whole, name) for name in modules()[whole].defined] if whole in modules() else [of]


@cache
def users() -> dict[Definition, set[Definition]]:
    """Of each definition those that name it."""
    found: dict[Definition, set[Definition]] = defaultdict(set)
    for name, module in modules().items():
        for user, node in module.defined.items():
            names = {each.id for each in ast.walk(node) if isinstance(each, ast.Name)}
            names |= {each.arg for each in ast.walk(node) if isinstance(each, ast.arg)}  # a test's fixtures
            found[Definition(name, "")].add(Definition(name, user))
            for used in names - {user}:
                of = Definition(name, used) if used in module.defined else module.imported.get(used)
                for each in _parts(_origin(of)) if of is not None else ():
                    found[each].add(Definition(name, user))
    return found


def tests_of(fault: Fault) -> list[str]:
    """Those tests that lead to a function on the shortest way, as pytest is told them; those of its name first."""
    start = Definition(fault.module, fault.function.partition(".")[0])
    words, name = _words(fault.module), fault.function.rpartition(".")[2].strip("_")
    seen, edge = {start}, {start}
    ranked: list[tuple[object, ...]] = []
    for distance in range(_MAX_DISTANCE):
        edge = {user for each in edge for user in users()[each]} - seen
        seen |= edge
        for test in edge:
            module = modules()[test.module]
            if module.path.name.startswith("test_") and test.name.startswith("test_"):
                text = ast.unparse(module.defined[test.name])
                by_name = len(words & _words(test.module)) + 2 * (re.search(rf"\b{name}\b", text) is not None)
                rank = (distance - by_name, len(module.imported), test)
                ranked.append((*rank, f"{module.path.relative_to(ROOT)}::{test.name}"))
    return [str(each[-1]) for each in sorted(ranked)] or _files_named_like(fault.module)


def _files_named_like(module: str) -> list[str]:
    """The files of tests that share a word with a module that only an entry point leads to, as of a command."""
    files = [path for folder in ("tests", "lab/tests") for path in sorted((ROOT / folder).glob("test_*.py"))]
    return [str(path.relative_to(ROOT)) for path in files if (_words(module) - {"lab", "cli"}) & _words(path.stem)]


def _words(name: str) -> set[str]:
    """The words of a module's name, or what is the same of `calibrate` and `calibration`."""
    return {word[:5] for word in re.split(r"[._]", name)} - {"test", "touch"}


def compiled_with(fault: Fault) -> set[Definition]:
    """Compiled loops that a compiled function is part of: their caches know nothing of its change."""
    edge = {Definition(fault.module, fault.function.partition(".")[0])}
    found: set[Definition] = set()
    while edge := {each for each in edge - found if _is_compiled(each)}:
        found |= edge
        edge = {user for each in edge for user in users()[each]}
    return found


def _is_compiled(of: Definition) -> bool:
    node = modules()[of.module].defined.get(of.name)
    return isinstance(node, ast.FunctionDef) and any("njit" in ast.unparse(each) for each in node.decorator_list)


# --- running them -----------------------------------------------------------------------------------------------------


def copied_tree(folder: Path) -> Path:
    """A copy of code and tests with their compiled loops; whatever else tests look at is linked to."""
    folder.mkdir()
    for each in ROOT.iterdir():
        if each.name in ("src", "tests", "lab"):
            shutil.copytree(each, folder / each.name, symlinks=True)
        elif not each.name.startswith("."):
            (folder / each.name).symlink_to(each)
    return folder


def outcome(fault: Fault, tree: Path) -> tuple[str, str]:
    """What became of a fault, "noticed", "not noticed" or "gone"; and what it was."""
    original = modules()[fault.module].path if fault.module in modules() else None
    changed = None if original is None else laid(fault, original.read_text(encoding="utf-8"))
    if original is None or changed is None:
        return "gone", fault.before
    text, change = changed
    file = tree / original.relative_to(ROOT)
    dropped = [modules()[each.module].path.relative_to(ROOT).parent / "__pycache__" for each in compiled_with(fault)]
    for folder in dropped:
        shutil.rmtree(tree / folder, ignore_errors=True)
    file.write_text(text, encoding="utf-8")
    try:
        noticed = any(_fails(tests, tree) for tests in (tests_of(fault), [REPLAYS]) if tests)
    finally:
        shutil.copy2(original, file)
        for folder in dropped:
            shutil.rmtree(tree / folder, ignore_errors=True)
            if (ROOT / folder).exists():
                shutil.copytree(ROOT / folder, tree / folder)
    return "noticed" if noticed else "not noticed", change


def _fails(tests: Sequence[str], tree: Path) -> bool:
    """Whether one of these tests, but for the slow ones, fails, or nothing can be imported any more."""
    pytest = [sys.executable, "-m", "pytest", "-q", "-x", "-m", "not slow", "-p", "no:cacheprovider", "-p", "no:xdist"]
    environment = {key: value for key, value in os.environ.items() if key != "TOUCHLINE_DATA"}
    environment["PYTHONPATH"] = f"{tree / 'src'}:{tree / 'lab' / 'src'}"
    status = subprocess.run([*pytest, *tests], cwd=tree, env=environment, capture_output=True, check=False).returncode
    assert status != 4, f"pytest does not know one of {tests}"
    return status in (1, 2)


def outcomes(faults: Sequence[Fault]) -> Iterator[tuple[Fault, tuple[str, str]]]:
    """Every fault with what became of it, in order."""
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(_WORKERS) as pool:
        trees: Queue[Path] = Queue()
        for number in range(_WORKERS):
            trees.put(copied_tree(Path(folder) / str(number)))

        def tried(fault: Fault) -> tuple[str, str]:
            tree = trees.get()
            try:
                return outcome(fault, tree)
            finally:
                trees.put(tree)

        yield from zip(faults, pool.map(tried, faults), strict=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", type=int, nargs="?", default=1, help="functions of every room")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--list", type=Path, metavar="FILE", help="the faults of a list instead")
    given = parser.parse_args()
    faults = drawn(given.count, given.seed) if given.list is None else listed(given.list)
    ends = Counter[str]()
    for fault, (end, change) in outcomes(faults):
        ends[end] += 1
        if end != "noticed":
            print(f"{end}: {fault.module}.{fault.function}, {change}", flush=True)
    looked = ends["noticed"] + ends["not noticed"]
    print(f"{ends['noticed']} of {looked} faults are noticed; the code of {ends['gone']} is gone")
    return 0


if __name__ == "__main__":
    sys.exit(main())
