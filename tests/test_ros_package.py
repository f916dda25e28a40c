"""ros/touchline_ros without ROS: its grammar, the node's parameters and their page."""

from __future__ import annotations

import ast
import importlib.util
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "ros" / "touchline_ros"


def test_the_package_keeps_to_python_3_10() -> None:
    for path in PACKAGE.rglob("*.py"):
        ast.parse(path.read_text(), feature_version=(3, 10))


def test_the_page_has_every_parameter_and_the_package_its_program() -> None:
    file = PACKAGE / "touchline_ros" / "parameters.py"
    spec = importlib.util.spec_from_file_location("touchline_ros_parameters", file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    page = (ROOT / "docs" / "how-to-ros.md").read_text()
    missing = [
        each.name for each in module.PARAMETERS if f"| `{each.name}` |" not in page or each.description not in page
    ]
    assert missing == []
    node = (PACKAGE / "touchline_ros" / "node.py").read_text()
    assert [each.name for each in module.PARAMETERS if f'"{each.name}"' not in node] == []
    package = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert package.findtext("name") == "touchline_ros"
    assert package.findtext("export/build_type") == "ament_python"
    assert "def main(" in node
