"""Renews the facts of `replays.yaml` and the golden trajectories: `make goldens`. Prints what has changed.

`python tests/goldens.py WORD`: of the rows whose name holds the word alone.
"""

from __future__ import annotations

import math
import sys
import time
from typing import Any

import numpy as np
import yaml
from replays import FACTS, GOLDENS, LIST, MACHINE, Facts, facts_of, name_of, replayed, trajectory

STYLE: Any = {"default_flow_style": True, "width": math.inf, "sort_keys": False, "allow_unicode": True}
MARGIN = 1.1  # of the bound of a mean error to the error


def bounded(facts: Facts) -> dict[str, Any]:
    """Facts as the list holds them."""
    error_m = None if facts.error_m is None else math.ceil(1000.0 * MARGIN * facts.error_m) / 1000.0
    return {**facts._asdict(), "error_m": error_m}


def main(word: str = "") -> None:
    lines, seconds = LIST.read_text(encoding="utf-8").splitlines(), 0.0
    kept = dict(np.load(GOLDENS)) if GOLDENS.exists() else {}
    goldens: dict[str, Any] = {"machine": np.array(MACHINE)}
    for k, line in enumerate(lines):
        if not line.startswith("- "):
            continue
        (row,) = yaml.safe_load(line)
        name, keys = name_of(row), (f"{name_of(row)}, poses", f"{name_of(row)}, others")
        if word not in name and keys[0] in kept:
            goldens |= {key: kept[key] for key in keys}
            continue
        begun_s = time.process_time()
        estimates, truth = replayed(row)
        took_s = time.process_time() - begun_s
        seconds += took_s
        before = {key: row.pop(key, None) for key in FACTS}
        after = bounded(facts_of(estimates, truth))
        goldens |= dict(zip(keys, trajectory(estimates), strict=True))
        tracked = sum(e.status == "tracking" for e in estimates)
        print(f"{name}: {tracked} of {len(estimates)} tracked, {took_s:.2f} s", flush=True)
        for key in FACTS:
            print(f"  {key}: {after[key]}" + ("" if before[key] == after[key] else f" (was {before[key]})"))
        dumped = yaml.safe_dump(
            row | after, default_flow_style=True, width=math.inf, sort_keys=False, allow_unicode=True
        )
        lines[k] = f"- {dumped.strip()}"
    LIST.write_text("\n".join(lines) + "\n", encoding="utf-8")
    GOLDENS.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(GOLDENS, **goldens)
    print(f"{seconds:.0f} s; {GOLDENS.name}: {GOLDENS.stat().st_size / 1e3:.0f} kB")


if __name__ == "__main__":
    main(*sys.argv[1:])
