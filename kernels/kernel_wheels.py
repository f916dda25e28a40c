"""Wheels with the loops of `touchline compile --all` compiled for a kind of processor, x86-64-v3 and ARMv8:

    python kernels/kernel_wheels.py FOLDER

On x86-64 with AVX2, for the Python and the packages of this environment, Touchline among them. For x86-64-v3 they are
compiled as they run, and for ARMv8 from the signatures that were met, by the same compiler, without running them.
`touchline.packed_loops` takes them where they fit.
"""

from __future__ import annotations

import importlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import touchline
from touchline.packed_loops import DESCRIPTION, PACKAGE, surroundings

HERE = Path(__file__).resolve().parent
SOURCES = Path(touchline.__file__).parent
ALL_LOOPS = "from touchline.cli import main; main(['compile', '--all', '--workers', '1'])"


@dataclass(frozen=True)
class Processors:
    """A kind of them: LLVM's names of system, processor and what it must offer, and the platform's name in a wheel."""

    target: str
    processor: str
    features: str
    platform: str


V3 = Processors(
    "x86_64-unknown-linux-gnu",
    "x86-64-v3",
    "cx16 sahf popcnt ssse3 sse4.1 sse4.2 avx avx2 bmi bmi2 f16c fma lzcnt movbe",
    "manylinux_2_28_x86_64",
)
# No more than what each has that runs Linux: under an emulator LLVM does not see the features.
ARMV8 = Processors("aarch64-unknown-linux-gnu", "generic", "", "manylinux_2_28_aarch64")
PROJECT = """
[build-system]
requires = ["hatchling>=1.27,<2"]
build-backend = "hatchling.build"

[project]
name = "touchline-kernels"
version = "{touchline}"
description = "Touchline's inner loops, compiled: its first start does not wait for a compiler"
license = "Apache-2.0"
license-files = ["LICENSE"]
authors = [{{ name = "The Touchline developers" }}]
requires-python = "=={python}.*"
dependencies = ["touchline=={touchline}", "numba=={numba}", "llvmlite=={llvmlite}", "numpy=={numpy}.*"]
"""


def compiled(kind: Processors, kept: Path, work: str) -> None:
    """Compile for a kind of processors, into the folder `kept`, in a process of its own. work: Python's, done there."""
    environment = {**os.environ, "NUMBA_CPU_NAME": kind.processor, "NUMBA_CPU_FEATURES": "", "NUMBA_OPT": "1"}
    environment |= {"NUMBA_CACHE_DIR": str(kept), "NUMBA_DISABLE_INTEL_SVML": "1", "PYTHONPATH": str(HERE)}
    begin = "import kernel_wheels; kernel_wheels.leave_out_annotations(); "
    subprocess.run([sys.executable, "-c", begin + work], env=environment, check=True)


def compiled_from(met: Path, kind: Processors, kept: Path) -> None:
    """The same from the signatures in a folder that `compiled` wrote, for processors that cannot run here."""
    compiled(kind, kept, f"kernel_wheels.compile_signatures({str(met)!r}, {kind.target!r})")


def leave_out_annotations() -> None:
    """Numba keeps each loop's source text and its path beside the code, a quarter of it: nobody reads it."""
    from numba.core.compiler import CompileResult

    reduced = CompileResult._reduce
    CompileResult._reduce = lambda self: reduced(self._replace(type_annotation=""))


def compile_signatures(met: str, target: str) -> None:
    """Compile every signature found in a folder for another system than this one, and run nothing."""
    from llvmlite import binding
    from llvmlite.binding import targets

    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    for module in (binding, targets):
        module.get_process_triple = module.get_default_triple = lambda: target

    from numba.core.caching import IndexDataCacheFile

    from touchline.compiling import leave_out_c_wrappers

    leave_out_c_wrappers()
    for source, folder in _kept_for(Path(met)):
        if not any(folder.glob(f"{source.stem}.*.nbi")):
            continue
        name = ".".join(("touchline", *source.relative_to(SOURCES).with_suffix("").parts))
        for loop in kept_loops(importlib.import_module(name)):
            cache = loop._cache
            index = IndexDataCacheFile(folder, cache._impl.filename_base, cache._cache_file._source_stamp)
            for signature, *_ in index._load_index():
                loop.compile(signature)


def kept_loops(module: ModuleType) -> Iterator[Any]:
    """A module's own loops whose code Numba keeps."""
    from numba.core.caching import FunctionCache
    from numba.core.dispatcher import Dispatcher

    for loop in vars(module).values():
        own = isinstance(loop, Dispatcher) and loop.py_func.__module__ == module.__name__
        if own and isinstance(loop._cache, FunctionCache):
            yield loop


def packed(kept: Path, kind: Processors, package: Path) -> None:
    """What was compiled into a folder, as the package that a wheel holds: beside it what it fits."""
    package.mkdir(parents=True)
    for source, folder in _kept_for(kept):
        place = package / source.parent.relative_to(SOURCES)
        for file in folder.glob(f"{source.stem}.*.nb[ic]"):
            place.mkdir(parents=True, exist_ok=True)
            shutil.copy(file, place)
    built = surroundings() | {"target": kind.target, "processor": kind.processor, "features": kind.features.split()}
    (package / DESCRIPTION).write_text(json.dumps(built, indent=1), encoding="utf-8")
    (package / "__init__.py").write_text('"""Compiled loops of Touchline; nothing to import."""\n', encoding="utf-8")


def wheel(kept: Path, kind: Processors, project: Path, output: Path) -> None:
    """The wheel of what was compiled into a folder, for exactly the packages that are here. project: a new folder."""
    packed(kept, kind, project / PACKAGE)
    (project / "pyproject.toml").write_text(PROJECT.format(**surroundings()), encoding="utf-8")
    shutil.copy(HERE.parent / "LICENSE", project)
    subprocess.run([sys.executable, "-m", "build", "--wheel", project], check=True)
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    tags = [f"--python-tag={python}", f"--abi-tag={python}", f"--platform-tag={kind.platform}"]
    made = next((project / "dist").glob("*.whl"))
    subprocess.run([sys.executable, "-m", "wheel", "tags", "--remove", *tags, made], check=True)
    shutil.copy(next((project / "dist").glob("*.whl")), output)


def _kept_for(kept: Path) -> list[tuple[Path, Path]]:
    """Each source file, and where Numba keeps its loops in a NUMBA_CACHE_DIR."""
    from numba.core.caching import UserProvidedCacheLocator

    place = UserProvidedCacheLocator.get_suitable_cache_subpath
    return [(source, kept / place(str(source))) for source in sorted(SOURCES.rglob("*.py"))]


def main() -> None:
    """Build both wheels into a folder, in which all else stays as it is."""
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        sys.exit("usage: python kernels/kernel_wheels.py FOLDER")
    output = Path(sys.argv[1])
    output.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as work:
        kept = {kind: Path(work) / "compiled" / kind.processor for kind in (V3, ARMV8)}
        compiled(V3, kept[V3], ALL_LOOPS)
        compiled_from(kept[V3], ARMV8, kept[ARMV8])
        for kind, folder in kept.items():
            wheel(folder, kind, Path(work) / "project" / kind.processor, output)


if __name__ == "__main__":
    main()
