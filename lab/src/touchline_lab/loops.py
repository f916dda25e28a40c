"""The compiled loops of the lab, for `touchline compile --all`."""

from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario


def compile_loops() -> None:
    """Render and observe the first frame of a mirror and of a humanoid."""
    for name in ("match", "humanoid-walk"):
        for level in ("images", "points"):
            next(iter(Simulation(open_scenario(name, 0, 0.5), level)))
