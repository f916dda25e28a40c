"""A localizer for `touchline bench points FILE.npz --program "python localizer.py"`: it answers what it was told."""

import sys

head = sys.stdin.readline().split()  # field 1 SEGMENTS ARCS
segments = [tuple(map(float, sys.stdin.readline().split())) for _ in range(int(head[2]))]  # x1 y1 x2 y2
arcs = [tuple(map(float, sys.stdin.readline().split())) for _ in range(int(head[3]))]  # cx cy radius start end


def localize(points, start=None, heading=None):
    """Your own localizer: points [(x, y), ...] in m, robot frame -> x, y, heading; None if it finds no pose."""
    return start


for line in sys.stdin:
    kind, *numbers = line.split()
    told = [float(number) for number in numbers]
    known = {"init": 3, "compass": 1, "none": 0}[kind]
    flat = told[known + 1 :]  # after the number of points
    points = list(zip(flat[::2], flat[1::2], strict=True))
    pose = localize(points, told[:3] if known == 3 else None, told[0] if known == 1 else None)
    print("none" if pose is None else " ".join(map(repr, pose)), flush=True)
