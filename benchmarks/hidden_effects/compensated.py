"""How far effects that were drawn independently take back each other's doing to the backbones.

    python benchmarks/hidden_effects/compensated.py DIR [MORE ...]

Of every batch of two and more hidden effects of the library, from its truth: by how much the change of frequency or
damping over the amplitude by one effect exceeds that by all of them. No search is run; `compensation.py` of the package
asks the same of a fitted set.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

import pymc_backbone as pb
from pymc_backbone.effects import LIBRARY

LEVELS = np.linspace(0.15, 0.95, 10)  # of the amplitude


def worst(truth: dict) -> float:
    """Return the largest ratio of one effect's change to that of all, over frequency and damping."""
    names = [name for name in truth["hidden"] if name in LIBRARY]
    model = pb.Oscillator(truth["mass"], [*truth["base"], *(name for name in names if name not in truth["base"])])
    values = {key: value for key, value in truth["nominal"].items() if key in model.parameter_names}

    def curves(absent: list[str]) -> np.ndarray:
        gone = {q.name for name in absent for q in LIBRARY[name].parameters if q.role == "strength"}
        left = {key: 0.0 if key in gone else value for key, value in values.items()}
        found = pb.simulate_backbone(model, left, LEVELS * truth["amplitude"])
        return np.array([found.frequency / np.mean(found.frequency), found.damping])

    whole = curves([])
    together = (whole - curves(names)).std(axis=1)
    return float(max(((whole - curves([name])).std(axis=1) / together).max() for name in names))


def main() -> None:
    """Print the quantiles, and how many sets are beyond some ratios."""
    truths = [json.loads(path.read_text()) for folder in sys.argv[1:] for path in Path(folder).glob("*/truth.json")]
    several = [truth for truth in truths if len([name for name in truth["hidden"] if name in LIBRARY]) > 1]
    ratios = np.array([worst(truth) for truth in several])
    ratios = ratios[np.isfinite(ratios)]
    print(f"{ratios.size} sets; median {np.median(ratios):.2f}, 90 % within {np.quantile(ratios, 0.9):.2f}, "
          f"largest {ratios.max():.2f}")  # fmt: skip
    for limit in (2.0, 3.0, 5.0):
        print(f"beyond {limit:g}: {np.count_nonzero(ratios > limit)}")


if __name__ == "__main__":
    main()
