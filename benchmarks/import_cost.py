"""What ``import pymc_backbone`` costs over ``import pymc``: each in a process of its own, in turns, many times.

    python benchmarks/import_cost.py --repeats 21

Seconds of computation (user and system) beside seconds on the clock: on a busy machine only the first say much.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
STATEMENTS = {
    "import pymc": "import pymc",
    "import pymc, pymc_backbone": "import pymc, pymc_backbone",
    "import pymc_backbone": "import pymc_backbone",
    "import pymc; from pymc_backbone import *": "import pymc; from pymc_backbone import *",
    "import pymc_backbone.cli.main": "import pymc_backbone.cli.main",
}


def cost(statement: str) -> tuple[float, float]:
    """Return seconds of computation and on the clock of a process that runs one statement."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    before, begin = os.times(), time.perf_counter()
    subprocess.run([sys.executable, "-c", statement], check=True, env=environment)
    after = os.times()
    used = after.children_user - before.children_user + after.children_system - before.children_system
    return used, time.perf_counter() - begin


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=21, metavar="N", help="processes of each kind (21)")
    repeats = parser.parse_args().repeats
    for statement in STATEMENTS.values():
        cost(statement)  # what is compiled and read from disk for the first time
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in STATEMENTS}
    for _ in range(repeats):
        for name, statement in STATEMENTS.items():
            found[name].append(cost(statement))
    print("| statement | computation, median [s] | lowest [s] | clock, median [s] | over `import pymc`, median [s] |")
    print("|---|---|---|---|---|")
    base = [used for used, _ in found["import pymc"]]
    for name, values in found.items():
        used, clock = zip(*values, strict=True)
        # pairs of neighbours in time: what else the machine did cancels
        over = statistics.median(a - b for a, b in zip(used, base, strict=True))
        numbers = f"{statistics.median(used):.3f} | {min(used):.3f} | {statistics.median(clock):.3f} | {over:+.3f}"
        print(f"| `{name}` | {numbers} |")


if __name__ == "__main__":
    main()
