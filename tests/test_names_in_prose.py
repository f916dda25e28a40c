"""Names in backticks in README and docs exist: words of the code, classes' own members, files, `touchline.x`."""

import ast
import importlib.util
import re
from functools import cache
from pathlib import Path

import touchline

ROOT = Path(__file__).parents[1]
CODE = ("src", "lab", "ros", "kernels", "examples", "docs", ".github", "tests")
KINDS = (".py", ".yaml", ".yml", ".toml", ".xml", ".msg", ".csv")
FOREIGN = {  # the reader's own, and other programs'
    *(
        "my_robot",
        "our_package.system:OUR_SYSTEM",
        "camera/your_model.py",
        "evil",
        "SEASON",
        "omni_calibration",
        "evo_ape",
    ),
    *("odom_factor", "gcsfs", "malloc", "malloc_trim", "MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_"),
    *("pandas.read_csv", "polars.scan_csv", "RMW_IMPLEMENTATION", "WALK.mcap", "shared_data", "small_data"),
    *(f"touchline.{group}" for group in ("commands", "calibrations", "loops")),
}


@cache
def words() -> set[str]:
    """All words of code, settings and build files, and all names and paths of files."""
    files = [path for place in CODE for path in (ROOT / place).rglob("*.*") if path.is_file()] + [*ROOT.iterdir()]
    read = [path for path in files if (path.suffix in KINDS and "tests" not in path.parts) or path.name == "Makefile"]
    found = {word for path in read for word in re.findall(r"\w+", path.read_text("utf-8"))}
    return found | {path.name for path in files} | {path.as_posix() for path in files}


@cache
def members() -> dict[str, set[str]]:
    """Class -> its bases, and the names that its body defines or gives to self."""
    found: dict[str, set[str]] = {}
    for path in [*(ROOT / "src").rglob("*.py"), *(ROOT / "lab").rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ClassDef):
                given = re.findall(r"^    (?:def )?(\w+)|self\.(\w+)|\((\w+)\):$", ast.unparse(node), re.MULTILINE)
                found.setdefault(node.name, set()).update(word for each in given for word in each if word)
    return found


def has(kind: str, name: str) -> bool:
    return name in members()[kind] or any(has(base, name) for base in members()[kind] & members().keys() - {kind})


def exists(name: str) -> bool:
    """Whether what looks like a name of ours is one; True for all that does not."""
    name = re.sub(r"\(.*\)$", "", name)
    if name in FOREIGN or name in words() or not re.fullmatch(r"[A-Za-z_]\w*(\.\w+)*|[a-z_]+(/\w+)+\.py", name):
        return True
    first, *more = name.split(".")
    if "/" in name:
        return any(word.endswith(f"/{name}") for word in words())
    if first == "touchline":
        return hasattr(touchline, more[0]) or importlib.util.find_spec(f"touchline.{more[0]}") is not None
    return has(first, more[0]) if first in members() else {first, *more} <= words()


def test_names_in_backticks_exist() -> None:
    assert not any(map(exists, ("fill_rows", "Filter.predicts", "systems/gone.py", "touchline.lokate")))
    unknown = []
    for page in (ROOT / "README.md", *(ROOT / "docs").glob("*.md")):
        prose = re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
        unknown += [f"{page.name}: {name}" for name in re.findall(r"`([^`\n]+)`", prose) if not exists(name)]
    assert unknown == []
