"""What the search for a missing effect found: plain records, from which report, files and figures follow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import xarray as xr

from ..._common.checks import FloatArray
from ...oscillator import Oscillator
from ..weighing.importance import LARGEST_K
from .curve_records import ForceCurves
from .design import Contender, Design, Plan
from .portraits import Portraits
from .verdict import LEAST_SHARE, MECHANISM_NAMED, AdequateBy, NamedLevel, Status, Verdict

UNMIXED = 1.1
"""R-hat above which draws say nothing of the parameters: each chain is somewhere else."""


@dataclass(frozen=True)
class Estimate:
    """A parameter of the extended model.

    Attributes
    ----------
    mean, sd, hdi_low, hdi_high : float
        Of the posterior over the batch [``unit``]; 95 % highest-density interval. Where nothing was sampled, or the
        draws did not mix, of the fit; where its parameters make up for each other, the values that the records allow
        along that valley, and the deviation that goes with an interval of this width.
    unit : str
        SI unit.
    is_low_open, is_high_open : bool
        Whether the interval ends there at a limit of what is looked for only, and the records allow values beyond.
    """

    mean: float
    sd: float
    hdi_low: float
    hdi_high: float
    unit: str
    is_low_open: bool = False
    is_high_open: bool = False


@dataclass(frozen=True)
class Candidate:
    """One set of effects beyond the base.

    Attributes
    ----------
    effects : tuple of str
        The effects added to the base; empty for the base alone.
    probability : float
        Posterior probability among all sets that were fitted.
    log_evidence : float
        Natural logarithm of the evidence, relative to that of the base alone.
    reduced_chi_square : float
        Of the deciding data term: per sample of the waveform, or per level value where only backbones were given.
    backbone_chi_square : float
        Of the backbones at the levels, per level value.
    status : Status
        ``best``, ``possible``, ``rejected`` or ``failed``: what became of it.
    reason : str
        Why, in one sentence.
    parameters : mapping of str to (float, float)
        Value over the batch and standard error, by parameter of the added effects.
    evidence_shift : float
        What importance sampling adds to the logarithm of the evidence by Laplace's method; NaN where not asked.
    pareto_k : float
        Shape of the tail of its weights: above 0.7 the shift is not trusted and not used, but for that of a bridge.
        NaN where nothing was drawn.
    is_bridged : bool
        Whether a bridge says the shift, which does without that tail.
    has_drift : bool
        Whether frequency and damping also change with time in this fit.
    """

    effects: tuple[str, ...]
    probability: float
    log_evidence: float
    reduced_chi_square: float
    backbone_chi_square: float
    status: Status
    reason: str
    parameters: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    evidence_shift: float = float("nan")
    pareto_k: float = float("nan")
    is_bridged: bool = False
    has_drift: bool = False

    @property
    def is_doubtful(self) -> bool:
        """Whether importance sampling was asked and neither it nor a bridge confirms the probability."""
        return bool(self.pareto_k > LARGEST_K) and not self.is_bridged


@dataclass(frozen=True)
class ScatterOfEffects:
    """How much the parameters of the added effects differ between specimens, as a share of their value.

    Attributes
    ----------
    median, low, high : float
        Of the posterior of the relative standard deviation over specimens; 5 % and 95 %.
    """

    median: float
    low: float
    high: float


@dataclass(frozen=True)
class EvidenceBasis:
    """What the probabilities of the sets rest on.

    Attributes
    ----------
    sentence : str
        Whether Laplace's method was corrected by importance sampling, for how many sets, and why for no more.
    sets : int
        How many were asked.
    cycles : float
        Simulated cycles that this took.
    """

    sentence: str
    sets: int = 0
    cycles: float = 0.0


@dataclass(frozen=True)
class LawProbability:
    """One law of a mechanism: the effect, and the probability of all sets together that hold it."""

    effect: str
    probability: float


@dataclass(frozen=True)
class MissingMechanism:
    """What effects have in common, whatever their law.

    Attributes
    ----------
    mechanism : str
        A key of `MECHANISMS`.
    probability : float
        Of all sets together that hold a law of it; where sets are exact, with half of the probability that no known
        effect does it, shared out alike.
    share_of_gap : float
        By what share of the base's gap it lowers that, the mean over all orders of adding mechanisms; zero where the
        best set does not hold it. The gap is the root mean square of the departure as a force or, where a set leaves
        noise, the root of the chi-square beyond the noise.
    laws : tuple of LawProbability
        The laws that it may be, most probable first.
    parameters : mapping of str to (float, float)
        Value over the batch and standard error, by parameter of the best set's laws of it.
    """

    mechanism: str
    probability: float
    share_of_gap: float
    laws: tuple[LawProbability, ...]
    parameters: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def is_certain(self) -> bool:
        """Whether it is probable enough for a name, and explains enough to be worth one."""
        return self.probability >= MECHANISM_NAMED and self.share_of_gap >= LEAST_SHARE


@dataclass(frozen=True)
class Remainder:
    """What the most probable set leaves of the gap in one observable, over the amplitudes that were visited.

    Attributes
    ----------
    observable : str
        frequency, damping or offset.
    size : float
        Measured minus the model with the set, where it is largest [``unit``].
    unit : str
        Hz, or 1.
    standard_errors : float
        The same in standard errors of it.
    share_of_gap : float
        Root mean square over that of the gap of the base model.
    amplitude_low, amplitude_high : float
        The range [m or rad].
    amplitude, values, errors : tuples of float
        The curve and its standard errors [``unit``] at some amplitudes [m or rad].
    """

    observable: str
    size: float
    unit: str
    standard_errors: float
    share_of_gap: float
    amplitude_low: float
    amplitude_high: float
    amplitude: tuple[float, ...]
    values: tuple[float, ...]
    errors: tuple[float, ...]


@dataclass(frozen=True)
class GapRange:
    """A range of amplitude in which measurement and base model differ.

    Attributes
    ----------
    observable : str
        frequency, damping or offset.
    amplitude_low, amplitude_high : float
        First and last level of the range [m or rad].
    gap : float
        Measured minus simulated where it is largest, mean over the specimens [``unit``].
    unit : str
        Hz, or 1.
    standard_errors : float
        The gap there in standard errors of that mean.
    direction : {"above", "below"}
        Whether the measurement lies above or below the model.
    """

    observable: str
    amplitude_low: float
    amplitude_high: float
    gap: float
    unit: str
    standard_errors: float
    direction: str


@dataclass(frozen=True)
class Check:
    """A check on the data: its name, whether it passed, and one sentence."""

    check: str
    passed: bool
    message: str


@dataclass(frozen=True)
class HeldOut:
    """The gap on data that the fit has not seen, as reduced chi-square.

    Attributes
    ----------
    before, after : float
        With the base model and with the extended one (NaN where there is none).
    labels : tuple of str
        What was left out, one entry each: a level or a specimen.
    before_each, after_each : (n,) arrays
        Reduced chi-square of each.
    """

    before: float
    after: float
    labels: tuple[str, ...]
    before_each: FloatArray
    after_each: FloatArray


@dataclass(frozen=True)
class Detectable:
    """The smallest effect of one kind that these data would have shown.

    Attributes
    ----------
    effect : str
        Its name.
    parameter : str
        Its leading parameter.
    value : float
        Strength that would have been detected with about 90 % probability [``unit``].
    unit : str
        SI unit.
    frequency, damping : float
        Its largest relative change of frequency and of damping over the levels; NaN where unknown.
    """

    effect: str
    parameter: str
    value: float
    unit: str
    frequency: float
    damping: float


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
    def is_sampled(self) -> bool:
        """Whether the parameters are those of draws: some were taken, and they mixed."""
        return self.posterior is not None and self.convergence.get("r_hat", float("inf")) <= UNMIXED
