"""Entry points of other packages: what cannot be used is told in one sentence and left out; `--help` imports none."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from touchline.cli import main
from touchline.errors import InputError
from touchline.plugins import PluginWarning, entry_points_of, load
from touchline.systems import SYSTEMS, SystemInfo

MODULE = """\
import typer
from touchline.systems import SYSTEMS
INFO, NONE = SYSTEMS["nubot-mti"], "no system"
app = typer.Typer()
def greet(name: str) -> None:
    print(f"hello {name}")
@app.command()
def one() -> None:
    print("one")
@app.command()
def two() -> None:
    print("two")
"""


class Installed:
    """Entry points in the place of those of installed packages."""

    def __init__(self) -> None:
        self.there: list[EntryPoint] = []

    def add(self, group: str, **values: str) -> None:
        self.there += [EntryPoint(name, value, f"touchline.{group}") for name, value in values.items()]

    def __call__(self, group: str) -> list[EntryPoint]:
        return [entry for entry in self.there if entry.group == group]


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Installed]:
    """Of a package `stranger`, which is not imported yet."""
    (tmp_path / "stranger.py").write_text(MODULE)
    (tmp_path / "broken.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(str(tmp_path))
    fakes = Installed()
    monkeypatch.setattr("touchline.plugins.entry_points", fakes)
    yield fakes
    for name in ("stranger", "broken"):
        sys.modules.pop(name, None)


def opened_systems() -> dict[str, SystemInfo]:
    """A registry of what is installed now."""
    return dict(type(SYSTEMS)().items())


def test_a_system_of_another_package_is_imported_when_asked_for(installed: Installed) -> None:
    installed.add("systems", theirs="stranger:INFO")
    systems = type(SYSTEMS)()
    assert list(systems) == ["touchline", "theirs"]
    assert "stranger" not in sys.modules
    assert systems["theirs"].name == "nubot-mti"
    assert list(systems.values())[1] is systems["theirs"]
    with pytest.raises(KeyError):
        systems["others"]


@pytest.mark.parametrize(
    ("value", "why"),
    [
        ("broken:INFO", "ZeroDivisionError: division by zero"),
        ("stranger:MISSING", "AttributeError: module 'stranger' has no attribute 'MISSING'"),
        ("nowhere:INFO", "ModuleNotFoundError: No module named 'nowhere'"),
        ("stranger:NONE", "it is no SystemInfo"),
    ],
)
def test_a_system_that_cannot_be_used_is_left_out(installed: Installed, value: str, why: str) -> None:
    installed.add("systems", theirs=value)
    package = value.partition(":")[0]
    with pytest.warns(PluginWarning) as told:
        assert list(opened_systems()) == ["touchline"]
    assert [str(one.message) for one in told] == [f"touchline.systems: 'theirs' of {package} is left out: {why}"]


def test_a_name_taken_twice_is_left_out(installed: Installed) -> None:
    installed.add("systems", theirs="stranger:INFO")
    installed.add("systems", theirs="touchline.published.nubot_mcl.system:NUBOT_MCL")
    installed.add("systems", theirs="touchline.published.nubot_mcl.system:NUBOT_MCL")  # one package found twice
    with pytest.warns(PluginWarning) as told:
        assert load(entry_points_of("touchline.systems")["theirs"]).name == "nubot-mcl"
    assert [str(one.message) for one in told] == [
        "touchline.systems: 'theirs' of stranger is left out: touchline has the name"
    ]


@pytest.mark.parametrize("group", ["systems", "commands"])
def test_names_of_this_package_are_kept(installed: Installed, group: str) -> None:
    installed.add("systems", touchline="stranger:INFO")
    installed.add("commands", run="stranger:greet")
    with pytest.warns(PluginWarning, match="is left out: touchline has the name"):
        assert main(["--help"]) == 0 if group == "commands" else len(opened_systems()) == 1


def test_help_lists_commands_and_imports_none(installed: Installed, capsys: pytest.CaptureFixture[str]) -> None:
    installed.add("commands", greet="stranger:greet", simulate="broken:simulate")
    assert main(["--help"]) == 0
    said = capsys.readouterr().out
    assert "A command of stranger." in said
    assert "Simulate a robot on a field" in said
    assert not {"stranger", "broken"} & set(sys.modules)


def test_commands_of_another_package_run(installed: Installed, capsys: pytest.CaptureFixture[str]) -> None:
    installed.add("commands", greet="stranger:greet", many="stranger:app", many_more="stranger:app")
    assert main(["greet", "you"]) == 0
    assert main(["many", "two"]) == 0
    assert capsys.readouterr().out == "hello you\ntwo\n"
    assert main(["greet"]) == main(["many", "three"]) == 2


def test_a_command_that_is_not_there_names_its_package(
    installed: Installed, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("simulate", "experiment", "bench", "tune"):
        assert main([name, "match"]) == InputError.exit_status == 2
        assert f"touchline {name} is a command of another package: pip install touchline-lab" in capsys.readouterr().err
    assert main(["simulation"]) == 2
    installed.add("commands", simulate="broken:simulate")
    with pytest.warns(PluginWarning, match="'simulate' of broken is left out: ZeroDivisionError"):
        assert main(["simulate", "match"]) == 2
    assert "broken, which brings it, cannot be imported" in capsys.readouterr().err
