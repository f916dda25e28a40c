"""`touchline check` tells what the monitor of our own system says of a recording."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fakes import WatchedSystem, write_recording

from touchline.checks import consistency
from touchline.checks.findings import Finding, Severity
from touchline.checks.survey import take_survey
from touchline.sources import open_source
from touchline.types import Estimate, Frame, Problem, ProblemCode


class Faulty(WatchedSystem):
    """Names a fault in ten images; an alarm without a name follows, and what is no fault."""

    def step(self, frame: Frame) -> Estimate:
        estimate, count = super().step(frame), len(self.seen)
        if count == 25:
            return replace(estimate, statistics={"motion": 1.2, "share": 1.1, "scale": 0.9})
        undecided = (Problem(ProblemCode.END_UNDECIDED, "undecided which end of the field it is"),)
        return replace(estimate, problems=undecided) if count == 5 else estimate


class Clean(WatchedSystem):
    """The same robot before anything happens."""

    def step(self, frame: Frame) -> Estimate:
        return super().step(replace(frame, stamp_ns=0))


def found(folder: Path, monkeypatch: pytest.MonkeyPatch, system: type[WatchedSystem], frames: int) -> list[Finding]:
    made: Iterator[WatchedSystem] = iter([system(np.random.default_rng(0), searching=())])
    monkeypatch.setattr(consistency, "open_system", lambda *_: next(made))
    seen: list[int] = []
    source = open_source(write_recording(folder, frames))
    survey = take_survey(source, lambda: seen.append(1))
    findings = list(consistency.check_consistency(survey))
    assert len(seen) == frames + consistency.images_to_run(source)
    return findings


def test_each_named_fault_is_told_with_its_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    named, unnamed = found(tmp_path / "walk", monkeypatch, Faulty, 30)
    assert (named.code, named.severity, named.where) == ("odometry-turn-sign", Severity.ERROR, "odometry.csv")
    assert named.what.endswith(" (in 10 of 30 images, first 1.0 s after the beginning)")
    assert (unnamed.code, unnamed.severity, unnamed.where) == ("sensors-disagree", Severity.WARNING, "field.yaml")
    assert "by motion and share (in 1 of 30 images, " in unnamed.what


def test_of_a_clean_recording_nothing_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (fine,) = found(tmp_path / "walk", monkeypatch, Clean, 30)
    assert (fine.severity, fine.what) == (Severity.OK, "sensors, images and field agree in 30 images, tracked in 30")


def test_a_few_images_tell_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (few,) = found(tmp_path / "walk", monkeypatch, Faulty, 20)
    assert (few.severity, few.what.startswith("too few images")) == (Severity.NOTE, True)
