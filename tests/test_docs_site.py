"""The documentation's site: what it is made of; links that lead nowhere are noticed. `make docs` builds it."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

import touchline
from touchline.systems import SYSTEMS

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
DESCRIBED_ON = {"nubot-mcl-alone": "nubot-mcl.md"}


@pytest.fixture(scope="module")
def site() -> ModuleType:
    spec = importlib.util.spec_from_file_location("build_site", ROOT / "docs" / "site" / "build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_page_is_in_the_menu_once(site: ModuleType, tmp_path: Path) -> None:
    """That of a system may be missing there."""
    site.stage(tmp_path / "docs")
    menu = re.findall(r'= "([\w-]+\.md)"', (ROOT / "docs" / "site" / "zensical.toml").read_text(encoding="utf-8"))
    pages = {page.name for page in (tmp_path / "docs" / "docs").glob("*.md")}
    assert len(menu) == len(set(menu))
    assert pages - {f"{name}.md" for name in SYSTEMS} <= set(menu) <= pages


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
    listed = set(re.findall(r"^::: (\S+)", page, re.MULTILINE))
    names = {name.rpartition(".")[2] for name in listed}
    assert [n for n in touchline.__all__ if n not in names and getattr(touchline, n).__module__ not in listed] == []


@pytest.mark.parametrize("name", SYSTEMS)
def test_every_system_has_a_page(name: str) -> None:
    page = ROOT / "docs" / DESCRIBED_ON.get(name, f"{name}.md")
    assert name in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_what_a_page_names_behind_a_file_is_defined_in_it(page: Path) -> None:
    named = re.findall(r"\[\w+\.py\]\(\.\./([\w/]+\.py)\) `(\w+)`", page.read_text(encoding="utf-8"))
    wrong = [
        (path, what)
        for path, what in named
        if not re.search(rf"^\s*(?:def|class) {what}\b", (ROOT / path).read_text(encoding="utf-8"), re.MULTILINE)
    ]
    assert wrong == []
