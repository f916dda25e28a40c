"""Writes docs/results.md and its pictures from a folder that `touchline experiment all` has written.

touchline experiment all --output results
python docs/images/results.py results

A folder of some experiments replaces their rows and sections alone.
"""

from __future__ import annotations

import platform
import sys
from pathlib import Path

import cv2

from touchline_lab.experiments import EXPERIMENTS
from touchline_lab.experiments.harness import PAGE

DOCS = Path(__file__).parents[1]
PICTURES = DOCS / "images" / "results"
MAX_PX = 1300  # width of a picture
JPEG = (cv2.IMWRITE_JPEG_QUALITY, 60, cv2.IMWRITE_JPEG_OPTIMIZE, 1, cv2.IMWRITE_JPEG_PROGRESSIVE, 1)
HEAD = """# Results of the experiments

The papers' experiments, rerun by `touchline experiment all`, our figures beside theirs. The papers drove a real robot
by hand; here it drives in simulation, but for the rows named *recorded*. So the rows are no comparison of methods, and
the papers' times were measured on other processors, one of them of 1.66 GHz.

The tables show the paper's figures, *its form here* (the system with `--preset paper`; what still differs from the
paper stands on the system's page) and ours, of [robots as built](simulation.md#a-robot-as-built), each drawn anew from
its seed; *ideal* stands for the same seeds' robots as designed. ± is the standard deviation over the seeds, the
last column says how many, from 0 on where nothing else is said. Brackets hold the interval of 95 %: by bootstrap over
the robots behind a mean, Wilson's behind a rate.

Measured on one virtual core of an {core}, while other programs ran. `python docs/images/results.py RESULTS` writes this
page from the folder of a run.
"""


def core_name() -> str:
    """The processor's name, as the system tells it."""
    info = Path("/proc/cpuinfo")
    names = [line for line in info.read_text().splitlines() if line.startswith("model name")] if info.exists() else []
    return names[0].partition(":")[2].strip() if names else platform.processor()


def table_rows(page: str) -> list[str]:
    """The lines of a page that are a table."""
    return [line for line in page.splitlines() if line.startswith("|")]


def section(folder: Path, name: str) -> list[str]:
    """An experiment's own page as a section, its pictures compressed into PICTURES."""
    lines = (folder / f"{name}.md").read_text(encoding="utf-8").splitlines()
    text = [f"## {name}", *(line for line in lines[1:] if not line.startswith("!["))]
    for picture in sorted(folder.glob(f"{name}-*.png")):
        target = PICTURES / picture.with_suffix(".jpg").name
        image = cv2.imread(str(picture))
        assert image is not None, f"{picture} is a picture"
        scale = min(1.0, MAX_PX / image.shape[1])
        smaller = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(target), smaller, JPEG)
        text += [f"![{picture.stem}](images/results/{target.name})", ""]
    return text


def main(folder: Path) -> None:
    """Write the page and its pictures."""
    PICTURES.mkdir(parents=True, exist_ok=True)
    page = DOCS / "results.md"
    head, *parts = page.read_text(encoding="utf-8").split("\n## ")
    before = {part.partition("\n")[0]: [*f"## {part}".rstrip("\n").splitlines(), ""] for part in parts}
    summary = table_rows((folder / PAGE).read_text(encoding="utf-8"))
    rows = [row.replace(".md)", ")").replace("](", "](#", 1) for row in summary if row.startswith("| [")]
    done = {row[len("| [") :].partition("]")[0]: row for row in rows}
    if set(done) >= set(EXPERIMENTS):
        lines = [HEAD.format(core=core_name()), *summary[:2], *(done[name] for name in EXPERIMENTS)]
    else:
        lines = [done.get(line[len("| [") :].partition("]")[0], line) for line in head.rstrip("\n").splitlines()]
    lines.append("")
    lines += [line for name in EXPERIMENTS for line in (section(folder, name) if name in done else before[name])]
    page.write_text("\n".join(lines).rstrip("\n") + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
