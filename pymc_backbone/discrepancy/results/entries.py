"""What a study holds of parameters, sets, mechanisms, gaps and checks, one record each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ..._common.checks import FloatArray
from ..weighing.importance import LARGEST_K
from .verdict import LEAST_SHARE, MECHANISM_NAMED, Status


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
