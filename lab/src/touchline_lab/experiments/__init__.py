"""The papers' experiments, rerun: each gives our figures beside the paper's, over several seeds."""

import importlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from touchline.errors import InputError
from touchline.evaluation.workers import Workers
from touchline.messages import did_you_mean
from touchline_lab.experiments.harness import ExperimentResult, Kept, Listener, progress_to

DEFAULT_SEEDS = 5


@dataclass(frozen=True, slots=True)
class Experiment:
    """An experiment: its name, one line about it, and the module whose function of that name runs it."""

    name: str
    description: str
    module: str

    def run(
        self,
        seeds: int = DEFAULT_SEEDS,
        listener: Listener | None = None,
        workers: Workers | None = None,
        folder: Path | None = None,
        part: str = "",
        first_seed: int = 0,
    ) -> ExperimentResult:
        """Run it; seeds >= 1, from first_seed on. listener: told, in a few words, how far it has come. workers: who
        computes its runs. folder: where one that can be resumed keeps its results; part: which of its tasks, a regular
        expression.
        """
        kept = None if folder is None else Kept(folder / f"{self.name}.jsonl", part)
        module = importlib.import_module(f"touchline_lab.experiments.{self.module}")
        function: Callable[[int], ExperimentResult] = getattr(module, self.name.replace("-", "_"))
        with progress_to(listener, workers, kept, first_seed):
            result = function(seeds)
            if result.seeds:  # photographs have none
                return replace(result, name=self.name)
            return replace(result, name=self.name, seeds=seeds, first_seed=first_seed)


EXPERIMENTS = {
    experiment.name: experiment
    for experiment in (
        Experiment("lu2013-occlusion", "Table 1: errors with part of the view hidden", "occlusion"),
        Experiment("lu2013-lighting", "Table 2: errors under other light, with frozen colours", "lighting"),
        Experiment("lu2013-kidnap", "figure 9: kidnapped robots find back by particles", "kidnap"),
        Experiment("lu2013-timing", "figure 12: time of the particles and of matching", "timing"),
        Experiment("lu2013-exposure", "figures 6, 10, 11: entropy, its ridge and the search", "lu2013_exposure"),
        Experiment("xiong-samples", "figure 7: errors of the 315 samples", "samples"),
        Experiment("xiong-kidnap", "figure 8: kidnapped robots find back by samples", "kidnap"),
        Experiment("xiong-convergence", "figure 9: RPROP from the five best samples", "samples"),
        Experiment("xiong-tracking", "Table 1: errors along straight lines", "occlusion"),
        Experiment("xiong-timing", "figure 11: time of a whole frame", "timing"),
        Experiment("nees", "how honest the stated covariances are, four systems", "nees"),
        Experiment("own", "our own system beside the others and the bound", "own"),
        Experiment("own-ablations", "our own system with parts left out", "own_ablations"),
        Experiment("own-humanoids", "our own system on walking humanoids", "own_humanoids"),
        Experiment("iris-lines", "figures 13, 14: line detection in three lightings", "iris_lines"),
        Experiment("iris-points", "Table I, figures 9, 15: errors at 20 places", "iris_points"),
        Experiment("iris-tracks", "figure 16: tracks of odometry, particles, fusion", "iris_points"),
        Experiment("iris-track", "figure 17: from A to B, by mode", "iris_points"),
        Experiment("iris-disturbances", "covered camera, slip, drifting gyro", "iris_disturbances"),
        Experiment("iris-timing", "section III.C: time of one update", "timing"),
        Experiment("faults", "the catalogue of faults: wrong, noticed, named", "faults"),
        Experiment("play", "hours of play with faults that come and go", "faulty_play"),
        Experiment("light", "lines and features found under every light", "light"),
        Experiment("photographs", "what is found in real photographs, one by one", "photographs"),
        Experiment("schulz-features", "sections 3, 4: lines, crossings, boundary found", "schulz_features"),
        Experiment("schulz-accuracy", "figure 5: five minutes of walking", "schulz_accuracy"),
        Experiment("schulz-lines-only", "Table 2, figure 6: by lines alone", "schulz_lines_only"),
        Experiment("schulz-timing", "Table 1: time of each part", "schulz_timing"),
        Experiment("schulz-belief", "figure 4: the belief by one frame", "schulz_belief"),
        Experiment("schulz-imu", "figure 3: the learned correction by roll and pitch", "schulz_imu"),
        Experiment("schulz-games", "section 6.3: games, a fall and re-entry", "schulz_games"),
    )
}


def chosen_experiments(name: str) -> list[Experiment]:
    """One experiment by name, or `all`. Raises InputError for an unknown name."""
    if name == "all":
        return list(EXPERIMENTS.values())
    if name not in EXPERIMENTS:
        raise InputError(f"experiment '{name}' is unknown; {did_you_mean(name, ['all', *EXPERIMENTS])}")
    return [EXPERIMENTS[name]]


__all__ = ["DEFAULT_SEEDS", "EXPERIMENTS", "Experiment", "ExperimentResult", "chosen_experiments"]
