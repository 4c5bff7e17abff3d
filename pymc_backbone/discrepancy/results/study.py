"""What the search for a missing effect found: plain records, from which report, files and figures follow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import xarray as xr

from ...oscillator import Oscillator
from .curve_records import ForceCurves
from .design import Contender, Design, Plan
from .entries import (
    Candidate,
    Check,
    Detectable,
    Estimate,
    EvidenceBasis,
    GapRange,
    HeldOut,
    MissingMechanism,
    Remainder,
    ScatterOfEffects,
)
from .portraits import Portraits
from .verdict import AdequateBy, NamedLevel, Verdict

UNMIXED = 1.1
"""R-hat above which draws say nothing of the parameters: each chain is somewhere else."""


@dataclass(frozen=True, eq=False)
class Study:
    """Everything `find_missing_effect` found.

    Attributes
    ----------
    verdict : Verdict
        The decision, a string: ``adequate``, ``found``, ``ambiguous`` or ``unexplained``.
    sentence : str
        The verdict in one sentence of plain words.
    base : Oscillator
        The model that was questioned.
    extended : Oscillator or None
        The base with the most probable set of effects added, where that is not empty.
    missing_effects : tuple of str
        The named effects; empty unless the verdict is ``found`` and the law is named.
    probability : float
        Posterior probability of the most probable set.
    candidates : tuple of Candidate
        All sets that were fitted, most probable first.
    ambiguous_sets : tuple of tuple of str
        The sets that cannot be told apart: where the verdict is ``ambiguous``, or where sets that are exact agree on
        the mechanism that is named and on no more; else empty.
    advice : tuple of str
        What measurement would tell them apart.
    reasons : tuple of str
        The naming in physical words with numbers.
    below_tolerance : tuple of str
        Effects that are detectable but smaller than the tolerance.
    where : tuple of GapRange
        Where base model and measurement differ.
    missing_p_value : float
        Of the test of "is anything missing at all".
    held_out_levels, held_out_specimens : HeldOut or None
        The gap on data that the fit has not seen; None where it cannot be measured.
    shrink, shrink_low, shrink_high : float
        Held-out gap before over after, with a 95 % interval; NaN where there is no extended model.
    adequate_by : AdequateBy or None
        Why the base is adequate, a string: ``statistics`` or ``tolerance``.
    tolerance : mapping of str to float
        Relative engineering tolerance by observable.
    detectable : tuple of Detectable
        The smallest effects that would have been seen.
    checks : tuple of Check
        Checks on the data.
    backbones : xarray.Dataset
        Measured backbones at levels (``value``, ``standard_error``; specimen, observable, level).
    before, after : xarray.Dataset or None
        Simulated backbones of each specimen at the same levels: base model, extended model.
    parameters : mapping of str to Mapping of str to Estimate
        By effect of the extended model (base effects included), then by parameter.
    posterior : xarray.DataTree or None
        Draws of the extended model; None where nothing was sampled.
    posterior_bounds : mapping of str to (float, float)
        Bounds of the Uniform priors of the sampled model.
    posterior_backbone : xarray.Dataset or None
        The backbone of the mean specimen that was sampled.
    findings : tuple of str
        What is wrong with the posterior, in words.
    convergence : mapping of str to float
        ``r_hat`` (largest), ``ess_bulk`` (smallest), ``draws``, ``chains``.
    settings : mapping
        Every setting of the run.
    notes : tuple of str
        What was assumed or done.
    seconds : float
        Of computation.
    seed : int
        Of everything random.
    present : Design or None
        The test that these records are; None where only backbones are known.
    contenders : tuple of Contender
        The sets that remain possible (``ambiguous_sets``) with their parameters, where there are records.
    plan : Plan or None
        Which test would tell them apart; None where none was looked for.

    mechanisms : tuple of MissingMechanism
        What may be missing by mechanism, most probable first; empty where the verdict is ``adequate``.
    named_level : NamedLevel or None
        What is named, a string: ``law`` or ``mechanism``; None unless the verdict is ``found``.
    remainder : tuple of Remainder
        What the most probable set leaves by observable, where no law is exact; else empty.
    force_curves : ForceCurves or None
        What is left as forces of displacement and of speed, where no law is exact: beside the mechanisms that are
        named or certain, or beside the base where none is; None elsewhere, and without records.
    scatter : ScatterOfEffects or None
        How much the effects of the extended model differ between specimens; None without effects, or of one specimen.
    evidence_basis : EvidenceBasis or None
        What the probabilities of the sets rest on.

    portraits : Portraits or None
        What single records show apart from their backbones: harmonics, forces, spectra; None without records.

    See Also
    --------
    find_missing_effect : makes it.
    write_study : writes its report.
    """

    verdict: Verdict
    sentence: str
    base: Oscillator
    extended: Oscillator | None
    missing_effects: tuple[str, ...]
    probability: float
    candidates: tuple[Candidate, ...]
    ambiguous_sets: tuple[tuple[str, ...], ...]
    advice: tuple[str, ...]
    reasons: tuple[str, ...]
    below_tolerance: tuple[str, ...]
    where: tuple[GapRange, ...]
    missing_p_value: float
    held_out_levels: HeldOut | None
    held_out_specimens: HeldOut | None
    shrink: float
    shrink_low: float
    shrink_high: float
    adequate_by: AdequateBy | None
    tolerance: Mapping[str, float]
    detectable: tuple[Detectable, ...]
    checks: tuple[Check, ...]
    backbones: xr.Dataset
    before: xr.Dataset
    after: xr.Dataset | None
    parameters: Mapping[str, Mapping[str, Estimate]]
    posterior: xr.DataTree | None
    posterior_bounds: Mapping[str, tuple[float, float]]
    findings: tuple[str, ...]
    convergence: Mapping[str, float]
    settings: Mapping[str, Any]
    notes: tuple[str, ...]
    seconds: float
    seed: int
    posterior_backbone: xr.Dataset | None = None
    present: Design | None = None
    contenders: tuple[Contender, ...] = ()
    plan: Plan | None = None
    mechanisms: tuple[MissingMechanism, ...] = ()
    named_level: NamedLevel | None = None
    remainder: tuple[Remainder, ...] = ()
    force_curves: ForceCurves | None = None
    scatter: ScatterOfEffects | None = None
    evidence_basis: EvidenceBasis | None = None
    portraits: Portraits | None = None

    @property
    def amplitude_unit(self) -> str:
        """m, or rad for a rotation."""
        return str(self.backbones.attrs.get("amplitude_unit", "m"))

    @property
    def is_sampled(self) -> bool:
        """Whether the parameters are those of draws: some were taken, and they mixed."""
        return self.posterior is not None and self.convergence.get("r_hat", float("inf")) <= UNMIXED
