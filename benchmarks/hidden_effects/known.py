"""The search for a missing effect where the answer is known from elsewhere: four measured structures, and case 5.

    python benchmarks/hidden_effects/known.py [FOLDER]

FOLDER holds `ship_roll_kvlcc2/run_21337.csv` (roll decay of a tanker model, angle in rad; doi 10.17632/2stvkyngj9.1;
published: quadratic damping B2 = 14.95 N m s^2) and `jointed_beam/*.csv` (hammer impacts on a bolted double beam,
velocity in m/s; doi 10.1098/rsta.2021.0194; a hysteretic joint), `brake_reuss_beam/HammerImpact.mat` (acceleration; doi
10.1016/j.ymssp.2021.108401; micro-slip in a lap joint) and `rotary_pendulum/*.txt` (angle in degrees after two header
lines, 1 kHz; a pendulum with dry friction). Without FOLDER only case 5 of arXiv:2410.11902 is run: records of Bouc-Wen
specimens, given to the empirical polynomial model of the paper.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import pymc_backbone as pb
from pymc_backbone.paper.cases import CASES

SHOWN = 12


def case_5() -> None:
    """Bouc-Wen specimens of the paper's population, released from about 0.5 m, 45 dB, against the polynomial model."""
    case, rng = CASES["5"], np.random.default_rng(5)
    records = []
    time = np.arange(0.0, 14.0, 0.025)
    for k, parameters in enumerate(case.draw(6, rng)):
        release = 0.5 * rng.uniform(0.9, 1.1)
        clean = pb.simulate_waveform(case.data, parameters, time, release).displacement
        noisy = clean + 10.0 ** (-45.0 / 20.0) * release / np.sqrt(2.0) * rng.standard_normal(time.size)
        records.append(pb.Record(f"specimen_{k + 1}", time, noisy))
    show("case 5", pb.find_missing_effect(case.model, records, quick=True, random_seed=1))


def ship(folder: Path) -> None:
    """Roll decay from a linear base."""
    records = pb.read_records(folder / "ship_roll_kvlcc2" / "run_21337.csv", unit="rad")
    study = pb.find_missing_effect(pb.Oscillator(135.0), records, quick=True, random_seed=1)
    show("ship roll run_21337", study)
    for item in study.candidates:
        if "quadratic_damping" in item.parameters and item.effects in study.ambiguous_sets:
            value, error = item.parameters["quadratic_damping"]
            print(f"  B2 in {' + '.join(item.effects)}: {value:.2f} +- {error:.2f} (published 14.95)")


def beam(folder: Path) -> None:
    """Bolted beam, mode at 122 Hz, from a linear base."""
    records = pb.read_records(folder / "jointed_beam")
    study = pb.find_missing_effect(pb.Oscillator(1.0), records, quick=True, random_seed=1, band=(90.0, 160.0))
    show("jointed beam", study)


def brake(folder: Path) -> None:
    """Lap joint, first mode at 80.6 Hz, one impact, from a linear base."""
    records = pb.read_records(folder / "brake_reuss_beam" / "HammerImpact.mat", columns="HIdata.acc1")
    study = pb.find_missing_effect(pb.Oscillator(1.0), records, quick=True, random_seed=1, band=(60.0, 100.0))
    show("Brake-Reuss beam", study)


def pendulum(folder: Path) -> None:
    """Swings of a pendulum on an encoder, pushed by hand and let go, from a linear base."""
    records = pb.read_records(folder / "rotary_pendulum", unit="deg")
    show("rotary pendulum", pb.find_missing_effect(pb.Oscillator(0.01), records, quick=True, random_seed=1))


def show(name: str, study: pb.Study) -> None:
    """Print the verdict, the table's first rows and the held-out gap."""
    print(f"{name}: {study.verdict} in {study.seconds:.0f} s. {study.sentence}")
    for item in study.mechanisms:
        laws = ", ".join(f"{law.effect} {law.probability:.2f}" for law in item.laws)
        print(f"  {item.mechanism}: {item.probability:.4f}, {item.share_of_gap:.2f} of the gap ({laws})")
    for item in study.remainder:
        print(f"  left in {item.observable}: {item.size:.3g} {item.unit}, {item.standard_errors:.1f} standard errors, "
              f"{item.share_of_gap:.1%} of the gap")  # fmt: skip
    rows = [item for item in study.candidates if item.probability > 1e-3][:SHOWN]
    for item in rows:
        print(f"  {' + '.join(item.effects) or 'nothing'}: {item.probability:.3f} ({item.status}), "
              f"reduced chi-square {item.reduced_chi_square:.3g}")  # fmt: skip
    for words, gap in (("levels", study.held_out_levels), ("specimens", study.held_out_specimens)):
        if gap is not None:
            print(f"  held-out {words}: reduced chi-square {gap.before:.4g} before, {gap.after:.4g} after")
    print(f"  the gap shrank {study.shrink:.4g} fold ({study.shrink_low:.4g} to {study.shrink_high:.4g})", flush=True)


def main() -> None:
    """Run what there is data for."""
    case_5()
    if len(sys.argv) > 1:
        ship(Path(sys.argv[1]))
        beam(Path(sys.argv[1]))
        brake(Path(sys.argv[1]))
        pendulum(Path(sys.argv[1]))


if __name__ == "__main__":
    main()
