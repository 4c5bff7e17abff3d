"""Frequency alone does not see damping: dry friction and a viscous damper, with one observable and with two.

The source paper's case 2. Its likelihood holds the frequency at each amplitude, which neither a light damper nor dry
friction changes: their posteriors are their priors. The logarithmic decrement at the same amplitudes tells both.

Run with ``python -m uv run examples/frequency_or_damping.py`` in the project's folder; half a minute once compiled.
"""

import argparse
import logging

import pymc_backbone as pb


def main() -> None:
    """Sample case 2 twice, and print what each posterior says of the population."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=float, default=1.0, help="factor on the number of draws")
    options = parser.parse_args()
    logging.disable(logging.INFO)  # the table is all that is wanted

    draws = max(int(options.draws * 4000), 100)
    for observables in (("frequency",), ("frequency", "damping")):
        result = pb.paper.run_case("2", "joint", draws=draws, tune=draws // 2, observables=observables)
        print(f"\n{' and '.join(observables)} of {len(result.vectors)} specimens")
        print(f"{'':<26}{'population':>18}{'prior':>18}{'posterior':>18}")
        for record in result.records:
            pairs = (
                (record["drawn_mean"], record["drawn_sd"]),
                result.case.prior[record["parameter"]],
                (record["mean"], record["sd"]),
            )
            label = f"{record['parameter']} [{record['unit']}]"
            print(f"{label:<26}" + "".join(f"{f'{mean:.4g} +- {sd:.3g}':>18}" for mean, sd in pairs))
        for sentence in pb.findings(result.posterior, result.case.prior_bounds):
            print("-", sentence)


if __name__ == "__main__":
    main()
