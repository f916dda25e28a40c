"""Builds the documentation's site, offline: python docs/site/build.py [FOLDER], or `make docs`.

The pages are those of docs/, as they stand. The README is the first page. The changelog and a table of all settings,
made from the code, are two more. Links to files that are no pages lead to the repository. Every warning ends the
build, and so does every link that leads nowhere.
"""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag

from settings_page import settings_page

ROOT = Path(__file__).parents[2]
PAGES = {"README.md": "index.md", "CHANGELOG.md": "changelog.md", "docs/site/reference.md": "reference.md"}
TABLE = re.compile(r"<table>.*?</table>", re.DOTALL)
LINK = re.compile(r"(!?\[[^]]*\]\()((?![a-z]+:|#)[^)\s]+)(\))")


def main(folder: Path) -> int:
    """Build the site into `folder`/site; the exit status says whether all is well."""
    if importlib.util.find_spec("zensical") is None:
        print("the site is built by zensical: pip install 'touchline[docs]'", file=sys.stderr)
        return 2
    shutil.rmtree(folder, ignore_errors=True)
    stage(folder)
    command = [sys.executable, "-m", "zensical", "build", "--clean", "--strict"]
    built = subprocess.run(command, cwd=folder, check=False)
    if built.returncode != 0:
        return built.returncode
    for page in (folder / "site").rglob("*.html"):
        page.write_text(TABLE.sub(with_columns, page.read_text(encoding="utf-8")), encoding="utf-8")
    broken = broken_links(folder / "site")
    print("\n".join(broken) if broken else f"{folder / 'site' / 'index.html'}: every link leads somewhere")
    return 1 if broken else 0


def stage(folder: Path) -> None:
    """Lay pages, pictures and configuration together as the site has them."""
    docs = folder / "docs"
    docs.mkdir(parents=True)
    settings = (ROOT / "docs" / "site" / "zensical.toml").read_text(encoding="utf-8")
    settings = settings.replace('paths = ["src"]', f"paths = ['{ROOT / 'src'}']")  # no link: hatchling would follow it
    (folder / "zensical.toml").write_text(settings, encoding="utf-8")
    shutil.copytree(ROOT / "docs" / "images", docs / "images", ignore=shutil.ignore_patterns("*.py", "__pycache__"))
    shutil.copy(ROOT / "docs" / "site" / "narrow.css", docs)
    names = PAGES | {f"docs/{page.name}": page.name for page in (ROOT / "docs").glob("*.md")}
    for source, name in names.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        (docs / name).write_text(with_site_links(text, source, names), encoding="utf-8")
    (docs / "settings.md").write_text(settings_page(), encoding="utf-8")


def with_site_links(text: str, source: str, names: dict[str, str]) -> str:
    """Markdown whose links lead to pages of the site, or into the repository."""

    def moved(link: re.Match[str]) -> str:
        path, hash_, anchor = link[2].partition("#")
        target = (ROOT / source).parent.joinpath(path).resolve().relative_to(ROOT).as_posix()
        if target in names:
            return f"{link[1]}{names[target]}{hash_}{anchor}{link[3]}"
        if target.startswith("docs/images/") and not target.endswith(".py"):
            return f"{link[1]}{target.removeprefix('docs/')}{link[3]}"
        return f"{link[1]}{address()}/blob/main/{target}{hash_}{anchor}{link[3]}"

    return LINK.sub(moved, text)


def with_columns(table: re.Match[str]) -> str:
    """A table whose cells say of which column they are: narrow.css shows it where columns don't fit side by side."""
    heads = re.findall(r"<th(?=[\s>])[^>]*>(.*?)</th>", table[0], re.DOTALL)
    heads = [re.sub("<[^>]*>", "", head).replace('"', "&quot;") for head in heads]
    names = iter(heads * table[0].count("</tr>"))
    return re.sub(r"<td(?=[\s>])", lambda _: f'<td data-column="{next(names)}"', table[0])


def address() -> str:
    """Where the repository lives; hatch_build.py alone says it."""
    found = re.search(r'^ADDRESS = "([^"]+)"', (ROOT / "hatch_build.py").read_text(encoding="utf-8"), re.MULTILINE)
    assert found is not None
    return found[1]


class _Page(HTMLParser):
    """The links of a page, and the anchors that others may lead to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.loaded: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        of = {key: value or "" for key, value in attrs}
        self.anchors |= {of[key] for key in ("id", "name") if key in of}
        if tag == "a" and "href" in of:
            self.links.append(of["href"])
        if tag in ("img", "script") and "src" in of:
            self.loaded.append(of["src"])
        if tag == "link" and "stylesheet" in of.get("rel", ""):
            self.loaded.append(of["href"])


def broken_links(site: Path) -> list[str]:
    """Links of a built site that lead nowhere, and whatever a page would load from elsewhere."""
    pages = {path: _Page(path.read_text(encoding="utf-8")) for path in site.rglob("*.html") if path.name != "404.html"}
    broken: list[str] = []
    for path, page in pages.items():
        shown = path.relative_to(site)
        broken += [f"{shown}: loads {link}" for link in page.loaded if re.match(r"[a-z]+:|//", link)]
        for link in [*page.links, *page.loaded]:
            if re.match(r"[a-z]+:|//", link):
                continue
            place, anchor = urldefrag(unquote(link))
            target = (path.parent / place).resolve() if place else path
            target = target / "index.html" if target.is_dir() else target
            if not target.exists() or (anchor and target in pages and anchor not in pages[target].anchors):
                broken.append(f"{shown}: {link} leads nowhere")
    return sorted(set(broken))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else ROOT / "build" / "docs").resolve()))
