"""Both packages keep the house's rules that import-linter does not hold, and the documents say what is so."""

from __future__ import annotations

import ast
import math
import re
import shlex
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer

from touchline.camera import open_camera
from touchline.cli.commands import app
from touchline.config import settings_rows
from touchline.field import open_field
from touchline.localization.one_shot.locate import LocateSettings
from touchline.sources import open_source
from touchline.systems import SYSTEMS

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "touchline"
PACKAGES = (PACKAGE, ROOT / "lab" / "src" / "touchline_lab")
DOCUMENTS = [
    ROOT / "README.md",
    ROOT / "CHANGELOG.md",
    ROOT / "lab" / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
]
UNTRUSTED_MODULES = (
    *("pickle", "dill", "cloudpickle", "joblib", "marshal", "shelve", "code", "runpy"),
    *("socket", "ssl", "urllib", "http", "ftplib", "smtplib", "requests", "httpx", "aiohttp", "asyncio", "subprocess"),
)
MAX_FUNCTION_LINES, MAX_PARAMETERS, MAX_STEP_LINES = 60, 8, 15


def python_files() -> list[Path]:
    return sorted(path for package in PACKAGES for path in package.rglob("*.py"))


def module_of(path: Path) -> str:
    """In the core without the package's name."""
    package = next(package for package in PACKAGES if package in path.parents)
    name = ".".join(path.relative_to(package.parent).with_suffix("").parts).removesuffix(".__init__")
    return name.removeprefix("touchline.")


def test_files_are_read_through_the_ground_floor_alone() -> None:
    """What opens safely stands in one place: nobody else opens a file that a user brings."""
    way = re.compile(r"\.read_(?:text|bytes)\(|\.open\(\"r|imread|imdecode|np\.load|yaml\.(?:safe_)?load|genfromtxt")
    keepers = ("files.opened", "files.yaml_text", "files.images", "files.arrays")
    # the kernel's own files and the package's; text that was read through `files` before
    harmless = re.compile(r"/proc/|Path\(__file__\)|# read already")
    found = [
        f"{module_of(path)}, line {number}: {line.strip()}"
        for path in python_files()
        if module_of(path) not in keepers
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if way.search(line) and not harmless.search(line)
    ]
    assert found == []


def could_be_too_large(text: str) -> bool:
    """By indentation and commas, twenty times as quick as a look at the tree."""
    for found in re.finditer(r"^( *)(?:async )?def ", text, re.MULTILINE):
        end = re.compile(rf"^ {{0,{len(found[1])}}}[^\s)]", re.MULTILINE).search(text, found.end())
        body = text[found.end() : end.start() if end else None]
        if body.count("\n") >= MAX_FUNCTION_LINES or body.partition("->")[0].count(":") > MAX_PARAMETERS:
            return True
    return False


def too_large(text: str) -> Iterator[str]:
    """Functions of more than 60 lines or 8 parameters (self and cls not counted)."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            given = node.args
            names = [argument.arg for argument in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
            parameters = len([name for name in names if name not in ("self", "cls")])
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            if lines > MAX_FUNCTION_LINES or parameters > MAX_PARAMETERS:
                yield f"line {node.lineno}: {node.name} has {lines} lines and {parameters} parameters"


def test_no_function_is_long_or_takes_much() -> None:
    texts = {path: path.read_text(encoding="utf-8") for path in python_files() if path.parent.name != "cli"}  # Typer's
    wrong = {module_of(path): list(too_large(text)) for path, text in texts.items() if could_be_too_large(text)}
    assert [found for found in wrong.items() if found[1]] == []


def test_a_long_function_is_noticed() -> None:
    assert list(too_large("def f(a, b, c, d, e, f, g, h): pass")) == []
    for text in (
        "class A:\n def f(self, a: A, b: A, c: A, d: A, e: A, f: A, g: A, h: A, i: A) -> A:\n  pass",
        "class A:\n    def f():\n" + "        pass\n" * 60 + "    def g():\n        pass",
    ):
        assert could_be_too_large(text)
        assert len(list(too_large(text))) == 1


def test_our_own_step_is_short() -> None:
    tree = ast.parse((PACKAGE / "systems" / "touchline.py").read_text(encoding="utf-8"))
    (step,) = (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.name == "step")
    assert (step.end_lineno or 0) - step.body[1].lineno < MAX_STEP_LINES  # behind the docstring


# --- settings ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("settings", [*(info.settings for info in SYSTEMS.values()), LocateSettings])
def test_every_setting_says_what_it_is(settings: Any) -> None:
    assert [key for key, _, description in settings_rows(settings) if len(description.split()) < 4] == []


@pytest.mark.parametrize("name", SYSTEMS)
def test_a_system_has_forty_settings_at_most(name: str) -> None:
    """Switches to the paper's form (`paper`) not counted: what nobody tunes is a constant beside its use."""
    keys = [key for key, _, _ in settings_rows(SYSTEMS[name].settings)]
    assert sum("paper" not in key.split(".") for key in keys) <= 40


# --- documents --------------------------------------------------------------------------------------------------------


def code_in(text: str) -> Iterator[str]:
    """Every line of a fenced block and every inline code span."""
    for block in re.findall(r"^```[a-z]*\n(.*?)^```", text, re.MULTILINE | re.DOTALL):
        yield from block.splitlines()
    yield from re.findall(r"`([^`\n]+)`", re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL))


@cache
def commands() -> Any:
    return typer.main.get_command(app)


def wrong_command(line: str) -> str | None:
    """What is wrong with a `touchline ...` line: an unknown command or option; None if nothing is."""
    words = shlex.split(line.partition(" > ")[0].partition("#")[0].replace("…", ""))
    group = commands()
    rest = words[1:]
    while rest and hasattr(group, "commands"):
        if rest[0] in group.list_commands(typer.Context(group)):
            _, group, rest = group.resolve_command(typer.Context(group), rest)
        elif group.name in ("fields", "bench"):  # a word that is no subcommand is a field, a recording
            group = group.commands["show" if group.name == "fields" else "recordings"]
        else:
            break
    known = {name for parameter in group.params for name in (*parameter.opts, *parameter.secondary_opts)}
    known |= {"--help", "-h"}
    if rest and not rest[0].startswith("-") and hasattr(group, "commands"):
        return f"unknown command: {line}"
    wrong = [word for word in rest if word.startswith("--") and word.partition("=")[0] not in known]
    return f"unknown {wrong[0]}: {line}" if wrong else None


@pytest.mark.parametrize("line", ["touchline dmeo", "touchline run X --ouput Y", "touchline fields new a A=1 --bsae x"])
def test_a_wrong_command_is_noticed(line: str) -> None:
    assert wrong_command(line) is not None


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_commands_in_documents_exist(document: Path) -> None:
    lines = [line.strip().removeprefix("$ ") for line in code_in(document.read_text(encoding="utf-8"))]
    assert [wrong for line in lines if line.startswith("touchline ") and (wrong := wrong_command(line))] == []
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    made = [line.split()[1] for line in lines if line.startswith("make ")]
    assert [target for target in made if target not in targets] == []


def anchors(document: Path) -> set[str]:
    """The anchors that GitHub gives a document's headings."""
    headings = re.findall(r"^#+ (.*)$", document.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_links_in_documents_resolve(document: Path) -> None:
    targets = re.findall(r"\]\(([^)\s]+)\)", document.read_text(encoding="utf-8"))
    broken = []
    for target in (target for target in targets if not re.match(r"[a-z]+:", target)):
        name, _, anchor = target.partition("#")
        path = (document.parent / name).resolve() if name else document
        if not path.exists() or (anchor and anchor not in anchors(path)):
            broken.append(target)
    assert broken == []


@pytest.mark.slow
def test_the_readme_s_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    block = re.search(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert block is not None
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    exec(compile(block.group(1), "README.md", "exec"), {})
    assert "heading" in capsys.readouterr().out


def yaml_blocks(name: str) -> list[str]:
    return re.findall(r"^```yaml\n(.*?)^```", (ROOT / "docs" / name).read_text(encoding="utf-8"), re.M | re.S)


def test_the_camera_files_of_the_how_to_can_be_used(tmp_path: Path) -> None:
    _, one_table, per_direction, perspective = yaml_blocks("how-to-recording.md")
    camera_file = tmp_path / "camera.yaml"
    camera_file.write_text(one_table, encoding="utf-8")
    assert open_camera(camera_file).ground_from_image([[239.5, 239.5 - 80.0]])[0] == pytest.approx([1.0, 0.0], abs=1e-4)
    camera_file.write_text(one_table.partition("range_table")[0] + per_direction, encoding="utf-8")
    assert open_camera(camera_file).ground_from_image([[239.5, 239.5 - 80.0]])[0] == pytest.approx([1.0, 0.0], abs=1e-4)
    assert open_camera(camera_file).ground_from_image([[239.5 - 80.0, 239.5]])[0] == pytest.approx(
        [0.0, 0.99], abs=1e-4
    )
    camera_file.write_text(perspective, encoding="utf-8")
    ahead = open_camera(camera_file).ground_from_image([[377.3, 238.6]])[0]
    assert ahead == pytest.approx([0.05 + 1.1 / math.tan(0.489), 0.0], abs=1e-6)


def test_the_field_file_of_the_how_to_can_be_used(tmp_path: Path) -> None:
    (block,) = yaml_blocks("how-to-field.md")
    field_file = tmp_path / "field.yaml"
    field_file.write_text(block, encoding="utf-8")
    field = open_field(field_file)
    assert (field.name, field.length, len(field.goals)) == ("our-lab", 12.0, 1)


def test_the_recording_of_the_how_to_can_be_opened(tmp_path: Path) -> None:
    example = ROOT / "examples" / "omni_msl_track_short"
    (tmp_path / "sequence.yaml").write_text(yaml_blocks("how-to-recording.md")[0], encoding="utf-8")
    (tmp_path / "images.csv").write_text("t,file\n0.1,images/000000.jpg\n", encoding="utf-8")
    (tmp_path / "images").symlink_to(example / "images")
    source = open_source(tmp_path, follow_links=True)
    assert (source.name, source.field.name, len(source)) == ("friday-3", "msl-18x12", 1)
    assert next(iter(source)).problem is None


def untrusted(text: str) -> Iterator[str]:
    """What a module imports or calls that would run what a file says, or reach the network."""
    words = (*UNTRUSTED_MODULES, "eval", "exec", "compile", "__import__", r"os\.(?:system|popen)", r"yaml\.\w*load")
    if not re.search(rf"\b(?:{'|'.join(words)}|allow_pickle)\b", text):  # which is quicker than a look at the tree
        return
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            named = [one.name for one in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            yield from (name for name in named if name.partition(".")[0] in UNTRUSTED_MODULES)
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            arguments = {word.arg: ast.unparse(word.value) for word in node.keywords}
            if called in ("eval", "exec", "compile", "__import__", "os.system", "os.popen", "yaml.unsafe_load"):
                yield called
            if called == "yaml.load" and arguments.get("Loader") not in ("_Loader", "yaml.SafeLoader"):
                yield called
            if arguments.get("allow_pickle", "False") != "False":
                yield called


def test_nothing_unpickles_evaluates_or_reaches_the_network() -> None:
    found = {
        module_of(path): names
        for path in python_files()
        if (names := list(untrusted(path.read_text(encoding="utf-8"))))
    }
    # joblib starts workers and reads no files here; git, by a fixed command
    assert found == {
        "evaluation.workers": ["joblib"],
        "live.udp": ["socket"],
        "touchline_lab.experiments.harness": ["subprocess"],
    }


@pytest.mark.parametrize(
    "text",
    [
        "import pickle",
        "from urllib.request import urlopen",
        "import http.client",
        "eval(text)",
        "yaml.load(text, Loader=yaml.Loader)",
        "np.load(path, allow_pickle=True)",
    ],
)
def test_what_would_run_a_file_is_noticed(text: str) -> None:
    assert len(list(untrusted(text))) == 1
