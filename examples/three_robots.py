"""Three robots and a ball in the simulator: each sends where it stands and where it sees the ball, as mates do.

    python examples/three_robots.py [--flipped 1] [--seconds 12]

One of them was given the wrong end of the field at the start. What its two mates and the ball say turns it: the mates
are known by name. Somebody who makes up names turns nobody, however many there are: all of them are one voice.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from touchline import Localizer
from touchline.geometry import Pose
from touchline.types import Estimate, ProblemCode, Status
from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario

FIELD, NAMES, BALL = "msl-18x12", ("keeper", "left", "right"), (1.5, 0.5)
SAID_EVERY = 2  # images


class Robot(NamedTuple):
    """A robot's simulation, and what tells it where it is. No compass: nothing but its mates tells the ends apart."""

    name: str
    simulation: Simulation
    localizer: Localizer


def team(flipped: int, seconds: float) -> list[Robot]:
    """Robots of three seeds; the flipped one is told the opposite of where it stands."""
    robots = []
    for number, name in enumerate(NAMES):
        scenario = open_scenario(
            "match", number + 1, seconds, (f"field={FIELD}", "motion.speed_m_s=1.0", "camera.rate_hz=5")
        )
        simulation, localizer = Simulation(scenario, "points"), Localizer(FIELD)
        place = simulation.start.mirrored() if number == flipped else simulation.start
        localizer.reset(tuple(place))
        robots.append(Robot(name, simulation, localizer))
    return robots


def tell(speaker: Robot, estimate: Estimate, listeners: Sequence[Robot], number: int) -> None:
    """Send the pose and the ball to the others, as one message."""
    if estimate.status is not Status.TRACKING:
        return
    sees_ball = estimate.pose.transform(seen_ball(speaker, number))[0]
    for other in listeners:
        own_ball = tuple(seen_ball(other, number)[0])
        # the ball is at one place: who sees it, too, knows where that puts itself
        said = {"place_m": tuple(sees_ball), "seen_m": own_ball, "spread_m": 0.4}
        other.localizer.add_evidence(f"{speaker.name}, of the ball", 0.98, message=number, **said)


def seen_ball(robot: Robot, number: int) -> np.ndarray:
    """(1, 2) where a robot sees the ball, in its own frame (m)."""
    truth: Pose = robot.simulation.truth[number]
    return truth.inverse().transform(np.array([BALL]))


def play(flipped: int, seconds: float) -> list[list[float]]:
    """How far each robot's pose is from the truth (m), image by image; says when one is turned."""
    robots = team(flipped, seconds)
    off_m: list[list[float]] = [[] for _ in robots]
    for number in range(len(robots[0].simulation)):
        estimates = []
        for robot, errors in zip(robots, off_m, strict=True):
            frame = robot.simulation.frame(number)
            for samples in (frame.odometry,):
                for stamp, row in zip(samples.stamp_ns, samples.values, strict=True) if samples else ():
                    robot.localizer.add_odometry(int(stamp), *row)
            estimate = robot.localizer.localize(frame.stamp_ns, observation=frame.observation)
            errors.append(estimate.pose.distance_to(robot.simulation.truth[number]))
            estimates.append(estimate)
            for problem in estimate.problems:
                if problem.code == ProblemCode.END_BY_OTHERS:
                    print(f"{frame.stamp_ns / 1e9:5.1f} s, {robot.name}: {problem}")
        if number % SAID_EVERY == 0:
            for robot, estimate in zip(robots, estimates, strict=True):
                tell(robot, estimate, [other for other in robots if other is not robot], number)
    return off_m


def main(arguments: Sequence[str] | None = None) -> None:
    """Print how far off each robot is at the start and at the end."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--flipped", type=int, default=1, help="which of the three is given the wrong end; -1: none")
    parser.add_argument("--seconds", type=float, default=12.0)
    chosen = parser.parse_args(arguments)
    for name, errors in zip(NAMES, play(chosen.flipped, chosen.seconds), strict=True):
        print(f"{name}: {errors[2]:.2f} m off after half a second, {errors[-1]:.2f} m at the end")


if __name__ == "__main__":
    main()
