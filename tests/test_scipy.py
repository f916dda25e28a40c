"""SciPy is for calibration, bags and statistics: imported where it is used, never on the way from image to pose."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).resolve().parents[1] / "src" / "touchline"
USERS = ("calibration", "sources/bags", "evaluation", "published/nimbro_lines/imu.py")
LAZY = ("sources/bags/transforms.py",)  # itself imported with bags and ROS 2's topics alone


def _imports(tree: ast.AST) -> bool:
    """Whether any of its statements imports SciPy."""
    nodes = list(ast.walk(tree))
    names = [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
    names += [alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    return any(name.split(".")[0] == "scipy" for name in names)


def test_scipy_is_imported_where_it_is_used() -> None:
    for path in SOURCE.rglob("*.py"):
        name, tree = path.relative_to(SOURCE).as_posix(), ast.parse(path.read_text())
        if _imports(tree):
            assert name.startswith(USERS), f"{name} imports SciPy"
            on_top = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
            assert name in LAZY or not any(map(_imports, on_top)), f"{name} imports SciPy at its top"


@pytest.mark.slow
def test_a_run_needs_none_of_scipys_parts(small_data: Path, tmp_path: Path) -> None:
    """Numba by itself looks into scipy.linalg for the BLAS."""
    run = ["run", str(small_data / "omni_9x6_points"), "--output", str(tmp_path / "run")]
    code = (
        f"import sys\nfrom touchline.cli import main\nassert main({run!r}) == 0\n"
        "print([name for name in sys.modules if name.startswith(('scipy.optimize', 'scipy.sparse', 'scipy.spatial', "
        "'scipy.stats'))])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
