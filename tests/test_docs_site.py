"""The documentation's site: what it is made of; links that lead nowhere are noticed. `make docs` builds it."""

from __future__ import annotations

import importlib.util
import re
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

import touchline
from touchline.systems import SYSTEMS

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def site() -> ModuleType:
    spec = importlib.util.spec_from_file_location("build_site", ROOT / "docs" / "site" / "build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_page_is_in_the_menu_once(site: ModuleType, tmp_path: Path) -> None:
    site.stage(tmp_path / "docs")
    menu = re.findall(r'= "([\w-]+\.md)"', (ROOT / "docs" / "site" / "zensical.toml").read_text(encoding="utf-8"))
    assert sorted(menu) == sorted(page.name for page in (tmp_path / "docs" / "docs").glob("*.md"))
    tomllib.loads((tmp_path / "docs" / "zensical.toml").read_text(encoding="utf-8"))


def test_links_lead_to_pages_pictures_or_the_repository(site: ModuleType) -> None:
    names = {"docs/method.md": "method.md", "README.md": "index.md"}
    text = "[a](method.md#x) [b](../README.md) ![c](images/p.png) [d](../src/a.py) [e](https://e.example) [f](#g)"
    moved = site.with_site_links(text, "docs/how-to-live.md", names)
    assert moved.startswith("[a](method.md#x) [b](index.md) ![c](images/p.png) ")
    assert f"[d]({site.address()}/blob/main/src/a.py) [e](https://e.example) [f](#g)" in moved


def test_a_link_that_leads_nowhere_and_what_is_loaded_from_elsewhere_are_named(
    site: ModuleType, tmp_path: Path
) -> None:
    (tmp_path / "a.html").write_text('<h2 id="x"></h2><a href="b.html#y"></a><a href="c.html"></a><a href="#x"></a>')
    (tmp_path / "b.html").write_text('<a href="a.html#x"></a><script src="https://cdn.example/a.js"></script>')
    assert site.broken_links(tmp_path) == [
        "a.html: b.html#y leads nowhere",
        "a.html: c.html leads nowhere",
        "b.html: loads https://cdn.example/a.js",
    ]


def test_all_that_is_public_stands_in_the_reference() -> None:
    page = (ROOT / "docs" / "site" / "reference.md").read_text(encoding="utf-8")
    listed = {name.rpartition(".")[2] for name in re.findall(r"^::: (\S+)", page, re.MULTILINE)}
    flowing = {name for name in touchline.__all__ if getattr(touchline, name).__module__ == "touchline.types"}
    assert listed | flowing >= set(touchline.__all__)


@pytest.mark.parametrize("name", [name for name in SYSTEMS if name not in ("touchline", "nubot-mcl-alone")])
def test_every_published_system_has_a_page_whose_equations_lead_to_the_code(name: str) -> None:
    """Whatever a row names behind a file is defined in that file."""
    page = (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")
    named = re.findall(r"\[\w+\.py\]\(\.\./([\w/]+\.py)\) `(\w+)`", page)
    assert len(named) > 7
    wrong = [
        (path, what)
        for path, what in named
        if not re.search(rf"^\s*(?:def|class) {what}\b", (ROOT / path).read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert wrong == []
