"""What the package index is told: addresses, a README whose links and pictures work outside the repository."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

import touchline
from touchline.cli import main

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PROJECT, LAB = (
    tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"] for folder in (ROOT, ROOT / "lab")
)


class Hook:
    """What hatchling's own base class gives; it is there only while a package is built."""

    def __init__(self, root: str, config: dict[str, Any]) -> None:
        self.root = root


@pytest.fixture(scope="module")
def hook() -> ModuleType:
    base: Any = ModuleType("hatchling.metadata.plugin.interface")
    base.MetadataHookInterface = Hook
    parents = ("hatchling", "hatchling.metadata", "hatchling.metadata.plugin")
    with pytest.MonkeyPatch.context() as patch:
        for name in parents:
            patch.setitem(sys.modules, name, ModuleType(name))
        patch.setitem(sys.modules, base.__name__, base)
        return loaded(ROOT / "hatch_build.py")


def loaded(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def metadata(hook: ModuleType) -> dict[str, Any]:
    told: dict[str, Any] = {}
    hook.Addresses(str(ROOT), {}).update(told)
    return told


def test_every_address_is_the_project_s(hook: ModuleType, metadata: dict[str, Any]) -> None:
    assert {"Homepage", "Documentation", "Changelog", "Issues"} == set(metadata["urls"])
    assert all(url.startswith(hook.ADDRESS) for url in metadata["urls"].values())


def test_every_link_of_the_readme_is_whole_and_leads_to_a_file(hook: ModuleType, metadata: dict[str, Any]) -> None:
    links = re.findall(r"\]\(([^)]+)\)", metadata["readme"]["text"])
    inside = [link.removeprefix(hook.ADDRESS) for link in links if link.startswith(hook.ADDRESS)]
    assert all(link.startswith(("https://", "#")) for link in links)
    for link in inside:
        view, branch, path = link.removeprefix("/").split("/", 2)
        assert (view, branch) == ("raw" if path.endswith((".jpg", ".png")) else "blob", "main")
        assert (ROOT / path.partition("#")[0]).exists(), path


def test_a_link_is_made_whole_once(hook: ModuleType) -> None:
    text = "[a](docs/a.md#b) ![c](docs/c.jpg) [d](#d) [e](https://e.example/e)"
    whole = hook.with_whole_links(text)
    assert f"[a]({hook.ADDRESS}/blob/main/docs/a.md#b) ![c]({hook.ADDRESS}/raw/main/docs/c.jpg)" in whole
    assert "[d](#d) [e](https://e.example/e)" in whole
    assert hook.with_whole_links(whole) == whole


def test_the_promise_names_what_is_public() -> None:
    text = (ROOT / "docs" / "versions.md").read_text(encoding="utf-8")
    (named,) = re.findall(r"all that `import touchline` gives: (.*?); the names", text, re.DOTALL)
    assert set(re.findall(r"`(\w+)`", named)) == {*touchline.__all__, "__version__"}


def test_both_packages_the_citation_and_the_changelog_have_one_version() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    newest = re.search(r"^## \[([^]]+)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert newest is not None
    assert {LAB["version"], cited["version"], newest[1]} == {PROJECT["version"]}
    assert f"touchline=={PROJECT['version']}" in LAB["dependencies"]
    assert cited["license"] == PROJECT["license"] == LAB["license"]


def test_the_core_needs_nothing_of_the_lab() -> None:
    names = {re.split(r"[<>=~; \[]", each)[0] for each in PROJECT["dependencies"]}
    assert names.isdisjoint({"touchline-lab", "matplotlib", "optuna"})


def test_what_a_run_s_page_is_made_of_comes_with_its_licence() -> None:
    licence = ROOT / "src/touchline/evaluation/web/uPlot-LICENSE.txt"
    assert "MIT License" in licence.read_text(encoding="utf-8")
    assert licence.relative_to(ROOT).as_posix() in PROJECT["license-files"]


def test_a_shell_completes_the_commands(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for name, value in (("COMPLETE", "complete_bash"), ("WORDS", "touchline comp"), ("CWORD", "1")):
        monkeypatch.setenv(f"_TOUCHLINE_{name}" if name == "COMPLETE" else f"COMP_{name}", value)
    with pytest.raises(SystemExit) as ended:
        main([])
    assert ended.value.code == 0
    assert capsys.readouterr().out.split() == ["compare", "compile"]


def test_every_extra_stands_on_the_page_of_installing() -> None:
    page = (ROOT / "docs" / "release.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^\| `\[([\w-]+)\]`", page, re.MULTILINE)) == set(PROJECT["optional-dependencies"])
    assert f"Python {PROJECT['requires-python'].removeprefix('>=')} or newer" in page


def test_a_release_is_tried_before_it_is_published() -> None:
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "release.yml").read_text(encoding="utf-8"))["jobs"]
    assert set(jobs["publish"]["needs"]) == {"try", "try-kernels", "docs"}
    made = re.findall(r"make (\w+)", " ".join(step.get("run", "") for job in jobs.values() for step in job["steps"]))
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert set(made) <= set(targets)
