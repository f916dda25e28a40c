"""Draws scenarios.jpg: one image of every scenario. Run as `python docs/images/scenarios.py FILE.jpg`."""

from __future__ import annotations

import sys

import cv2
import numpy as np

from touchline_lab.simulation.run import Simulation
from touchline_lab.simulation.scenario import open_scenario, scenario_names

COLUMNS, WIDTH, HEIGHT, TITLE = 4, 414, 264, 22
SHOWN_AT_S = {
    "chessboard": 8.0,
    "kidnap": 2.6,
    "light-changes": 14.0,
    "match": 3.1,
    "tour-20": 4.1,
    "humanoid-walk": 7.6,
}


def tile(name: str) -> np.ndarray:
    simulation = Simulation(open_scenario(name))
    times = simulation.image_times_s
    image = simulation.image(int(np.argmin(np.abs(times - SHOWN_AT_S.get(name, min(6.0, times[-1]))))))
    small = cv2.resize(image, (round(image.shape[1] * HEIGHT / image.shape[0]), HEIGHT), interpolation=cv2.INTER_AREA)
    card = np.full((HEIGHT + TITLE, WIDTH, 3), 255, np.uint8)
    left = (WIDTH - small.shape[1]) // 2
    card[TITLE:, left : left + small.shape[1]] = small
    cv2.putText(card, name, (6, 15), cv2.FONT_HERSHEY_SIMPLEX, 0.48, (40, 40, 40), 1, cv2.LINE_AA)
    return card


def main() -> None:
    tiles = [tile(name) for name in scenario_names()]
    tiles += [np.full_like(tiles[0], 255)] * (-len(tiles) % COLUMNS)
    rows = [np.hstack(tiles[first : first + COLUMNS]) for first in range(0, len(tiles), COLUMNS)]
    cv2.imwrite(sys.argv[1], np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, 82])


if __name__ == "__main__":
    main()
