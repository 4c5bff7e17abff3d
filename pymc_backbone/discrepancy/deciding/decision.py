"""What is said of records and what it rests on, as one record, and the probabilities from which something is said."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from ..fitting.joint_fit import Fit
from ..results.entries import MissingMechanism, Remainder
from ..results.verdict import AdequateBy, NamedLevel, Verdict
from ..sets.search import Set
from ..weighing.corrected_evidence import Corrected
from ..weighing.evidence import Evidence, LackOfFit

AGREE = 5.0
"""Reduced chi-square of the backbones up to which they agree with the samples."""
NAMED = 0.90
"""Probability from which a set is named."""
LISTED = 0.95
"""Probability that the sets listed as possible hold together."""
DRIFT_POSSIBLE = 0.05
"""Probability of a drift with time from which nothing is named."""
MOST_LISTED = 16
"""Sets that are listed as possible."""


@dataclass(frozen=True)
class Decision:
    """What is said, and what it rests on.

    Attributes
    ----------
    verdict : Verdict
        What is said.
    best : tuple of str
        The set it is said of.
    probability : float
        Of that set, with those that differ from it by effects below the tolerance.
    p_missing : float
        Of the test of "nothing is missing".
    lack : LackOfFit
        What the most probable set leaves.
    probabilities, evidences : mappings
        Of every set that was fitted.
    ranked : tuple of tuple of str
        The sets, most probable first.
    listed : tuple of tuple of str
        The sets that remain possible, where several do.
    rivals : tuple of tuple of str
        Sets for which the records speak as much as for the best one.
    undecided : tuple of str
        Mechanisms that are certain, but for a rival that does without them.
    below : tuple of str
        Effects below the tolerance.
    simulated : tuple of str or None
        The set of the model, where that has to hold what is below the tolerance to agree with the data; else None.
    adequate_by : AdequateBy or None
        Why nothing is missing.
    drift_probability : float
        Of the base with a drift in time.
    drifts : tuple of tuple of str
        Sets whose fit holds a drift in time beside their effects.
    has_second_mode : bool
        Whether a second mode beats in the records.
    is_moved_on : bool
        Whether something goes on moving the structures, and what no set explains is no larger.
    has_small_drift : bool
        Whether the model drifts with time, by less than the tolerance.
    against : float
        Reduced chi-square at which the best set leaves the backbones, where these speak against it; else NaN.
    unfinished : tuple of tuple of str
        Sets that could explain the backbones, but whose fit to the records did not come to rest.
    is_approximate : bool
        Whether no set is exact, and their probabilities are those with a departure.
    is_like : bool
        Whether what is named is like the laws of the best set, which explains the records, and not exactly of these.
    mechanisms : tuple of MissingMechanism
        What may be missing by mechanism, most probable first.
    named_level : NamedLevel or None
        What is named; None unless the verdict is ``found``.
    remainder : tuple of Remainder
        What the best set leaves, where none is exact.
    is_single_valued : bool
        Whether what no set explains goes with the amplitude, and not with the record.
    on_backbones : Fit or None
        The best set fitted to the backbones, where no fit of it keeps the phase of the records; then it is believed.
    corrected : Corrected
        By how much Laplace's method was off, for the sets between which the verdict lies.
    nearest : tuple of str or None
        Where no set explains the backbones: the one that leaves least of the samples, if that is much less than the
        base does.
    none_other : mapping of tuple of str to float
        Probability that a set which leaves noise is no imitation of what the library lacks.
    """

    verdict: Verdict
    best: Set
    probability: float
    p_missing: float
    lack: LackOfFit
    probabilities: Mapping[Set, float]
    evidences: Mapping[Set, Evidence]
    ranked: tuple[Set, ...] = ()
    listed: tuple[Set, ...] = ()
    rivals: tuple[Set, ...] = ()
    undecided: tuple[str, ...] = ()
    below: tuple[str, ...] = ()
    simulated: Set | None = None
    adequate_by: AdequateBy | None = None
    drift_probability: float = 0.0
    drifts: tuple[Set, ...] = ()
    has_second_mode: bool = False
    is_moved_on: bool = False
    has_small_drift: bool = False
    against: float = float("nan")
    unfinished: tuple[Set, ...] = ()
    is_approximate: bool = False
    is_like: bool = False
    mechanisms: tuple[MissingMechanism, ...] = ()
    named_level: NamedLevel | None = None
    remainder: tuple[Remainder, ...] = ()
    is_single_valued: bool = True
    on_backbones: Fit | None = None
    nearest: Set | None = None
    corrected: Corrected = field(default_factory=Corrected)
    none_other: Mapping[Set, float] = field(default_factory=dict)

    @property
    def model(self) -> Set:
        """The set that is simulated, verified and sampled; what it is named for is ``best``."""
        return self.best if self.simulated is None else self.simulated

    @property
    def above(self) -> Set:
        """What of ``best`` changes the backbones by more than the tolerance."""
        return tuple(name for name in self.best if name not in self.below)


def as_one(below: Set, chances: Mapping[Set, float]) -> dict[Set, float]:
    """Return the probabilities of sets where those that differ by what is below the tolerance are one."""
    kept: dict[Set, float] = {}
    for names, chance in chances.items():
        rest = tuple(name for name in names if name not in below)
        one = rest if rest in chances else names
        kept[one] = kept.get(one, 0.0) + chance
    return kept


def as_told(possible: Iterable[Set], below: Set, chances: Mapping[Set, float]) -> dict[Set, float]:
    """Return the probabilities of sets, which are one where they are listed without what is below the tolerance."""
    is_one = not any(set(names) & set(below) for names in possible)
    return as_one(below if is_one else (), chances)


def listed(chances: Mapping[Set, float], total: float) -> tuple[Set, ...]:
    """Return the most probable sets that together with ``total`` hold most of the probability."""
    kept: list[Set] = []
    for names in sorted(chances, key=lambda names: -chances[names]):
        kept.append(names)
        total += chances[names]
        if total > LISTED or len(kept) >= MOST_LISTED:
            break
    return tuple(kept)
