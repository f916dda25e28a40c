"""The papers' own form: the block `paper`, the preset that fills it, and that the systems run with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from syrupy.assertion import SnapshotAssertion

from touchline.api import prepare
from touchline.camera.exposure import ExposureSettings, Watch
from touchline.config import PAPER, load_settings, preset_values, settings_from_mapping, settings_rows, settings_tree
from touchline.errors import InputError
from touchline.systems import SYSTEMS, paper_settings

ROOT = Path(__file__).parents[1]
SHORT = ROOT / "examples" / "omni_msl_track_short"
OF_PAPERS = [name for name, info in SYSTEMS.items() if preset_values(info.settings)]


def keys(tree: dict[str, object], prefix: str = "") -> set[str]:
    """The keys of all values of a tree, with dots."""
    found = set()
    for key, value in tree.items():
        found |= keys(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}"}
    return found


def test_our_own_system_has_no_papers_form() -> None:
    with pytest.raises(InputError, match=r"^touchline has no preset 'paper'; iris-fusion, "):
        prepare(SHORT, "touchline", preset=PAPER)


@pytest.mark.parametrize("name", OF_PAPERS)
def test_the_preset_is_the_block_paper(name: str) -> None:
    """Every switch of the block has the paper's value, which is another one, and the preset changes nothing else."""
    model = SYSTEMS[name].settings
    ours, papers = settings_tree(model()), settings_tree(paper_settings(name))
    block = {key for key, _, _ in settings_rows(model) if key.startswith(f"{PAPER}.")}
    assert block == {f"{PAPER}.{key}" for key in keys(ours[PAPER])}
    assert {key: value for key, value in ours.items() if key != PAPER} == {
        k: v for k, v in papers.items() if k != PAPER
    }
    same = [key for key in keys(ours[PAPER]) if value_at(ours[PAPER], key) == value_at(papers[PAPER], key)]
    assert same == []


def value_at(tree: dict[str, object], key: str) -> object:
    value: object = tree
    for part in key.split("."):
        assert isinstance(value, dict)
        value = value[part]
    return value


def test_a_file_and_the_command_line_win_over_the_preset(tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text("paper:\n  particles:\n    roughening: 0.2\n")
    model = SYSTEMS["iris-fusion"].settings
    found = settings_tree(load_settings(model, file, ["paper.particles.nearby_ratio=0.3"], preset=PAPER))[PAPER]
    assert found["particles"] == {
        "max_units": 255.0, "tempering_threshold": 0.0, "roughening": 0.2, "nearby_ratio": 0.3,
    }  # fmt: skip


def test_settings_come_back_as_they_were_written() -> None:
    for info in SYSTEMS.values():
        settings = paper_settings(info.name)
        assert settings_from_mapping(info.settings, settings_tree(settings)) == settings


def test_mistakes_in_the_block_are_told_by_their_keys(tmp_path: Path, snapshot: SnapshotAssertion) -> None:
    file, told = tmp_path / "own.yaml", []
    file.write_text("max_points: 50\npaper:\n  lines:\n    min_green: x\n")
    for path, changes in (
        (None, ["paper.particles.roughenin=1"]),
        (None, ["paper.gyro.bias=1"]),
        (None, ["paper.lines.min_green=x"]),
        (None, ["lines.paper.min_green=1"]),
        (None, ["paper=3"]),
        (file, []),
    ):
        with pytest.raises(InputError) as refused:
            load_settings(SYSTEMS["iris-fusion"].settings, path, changes)
        told.append(str(refused.value).replace(str(tmp_path), ""))
    assert told == snapshot


def test_the_exposure_has_a_form_of_the_paper_too() -> None:
    paper = load_settings(ExposureSettings, preset=PAPER)
    assert (paper.watch, paper.overexposed_threshold, paper.whole_image) == (Watch.CENTRE, None, True)
    assert (paper.path.a_ms, paper.search.step_from_brightness, paper.search.elsewhere_nats) == (1.0, False, None)
    assert preset_values(ExposureSettings) != {}
    assert np.isfinite(paper.path.stops_range).all()
