"""Touchline lab: what measures Touchline. The simulator, the studies, the benchmark and the tuning."""

from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

__all__ = ["Simulation", "open_scenario"]
