"""A localizer for `touchline bench RECORDING --program "python stream.py"`: the odometry from the field's middle on."""

import csv
import math
import sys

head = sys.stdin.readline().split()  # field 1 SEGMENTS ARCS
field = [tuple(map(float, sys.stdin.readline().split())) for _ in range(int(head[2]) + int(head[3]))]
first = None

for line in sys.stdin:  # image T M N
    _, stamp_s, steps, rows = line.split()
    odometry = [tuple(map(float, sys.stdin.readline().split())) for _ in range(int(steps))]  # t x y theta
    seen = list(csv.reader(sys.stdin.readline() for _ in range(int(rows))))  # kind, x_m, y_m, x2_m, y2_m, …
    if odometry:
        _, x, y, heading = odometry[-1]
        first = first or (x, y, heading)
        dx, dy, turn = x - first[0], y - first[1], first[2]
        ahead, left = math.cos(turn) * dx + math.sin(turn) * dy, math.cos(turn) * dy - math.sin(turn) * dx
        pose = ahead, left, heading - turn
    print("none" if first is None else " ".join(map(repr, pose)), flush=True)
