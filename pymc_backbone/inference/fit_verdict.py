"""What a check of the fit found: numbers of every level, observable and specimen, and what they mean in words."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from .._common.checks import OBSERVABLE_UNITS, FloatArray

P_LIMIT = 0.01  # of the whole batch: below it the model does not fit
SPECIMEN_LIMIT = 0.001  # of the worst specimen, its number counted in: below it that specimen is not fitted
STANDS_OUT = 4.0  # standard errors from which on a level value is named in the words
REMEDY = "let `find_missing_effect` look for what is missing"
_TIMES = ("", "", "twice", "three", "four", "five", "six", "seven", "eight", "nine", "ten")


@dataclass(frozen=True)
class FitEntry:
    """Measured and predicted value of one observable at one level.

    Attributes
    ----------
    specimen : str or None
        None where the batch is compared as a distribution: then ``measured`` is its mean.
    observable : str
        frequency [Hz], damping [1] or offset [1].
    level : float
        Amplitude [m or rad].
    measured, standard_error : float
        Measured value and its standard error; of a distribution, the mean and its standard error.
    predicted, low, high : float
        Median of the backbones that draws of the posterior give, and the ends of their 95 % interval.
    scatter : float
        Standard deviation over the specimens that the comparison allows for, 0 where each has its own parameters.
    z : float
        Difference over the root of all variances: standard error, posterior, scatter.
    """

    specimen: str | None
    observable: str
    level: float
    measured: float
    standard_error: float
    predicted: float
    low: float
    high: float
    scatter: float
    z: float

    @property
    def relative(self) -> float:
        """Difference over the predicted value; that of an offset, which may be zero, as it is."""
        difference = self.measured - self.predicted
        return difference if self.observable == "offset" else difference / max(abs(self.predicted), 1e-300)


@dataclass(frozen=True)
class SpecimenFit:
    """How well one specimen is fitted with parameters of its own: chi-square at its best, degrees of freedom, p.

    Both as `goodness_of_fit` counts them: chi-square has the distribution of so many degrees of freedom.
    """

    specimen: str
    chi_square: float
    degrees_of_freedom: float
    reduced_chi_square: float
    p_value: float


@dataclass(frozen=True)
class ExcludedBy:
    """A bound of a prior at which the best fit ends although the data ask for a value beyond it."""

    parameter: str
    side: str
    bound: float
    asked: float


@dataclass(frozen=True)
class Narrow:
    """A level value that scatters less over draws of the posterior of a population than over its specimens.

    ``measured`` and ``simulated`` are standard deviations, measurement error taken out.
    """

    observable: str
    level: float
    measured: float
    simulated: float


@dataclass(frozen=True)
class GoodnessOfFit:
    """Whether a model describes what was measured; `goodness_of_fit` makes one.

    Attributes
    ----------
    likelihood : {"specimen", "pooled", "population"}
        How the posterior was compared with the specimens.
    p_value : float
        Chance of a misfit this large or larger if the model were right, each specimen with parameters of its own:
        uniform from 0 to 1 then, where the standard errors are right; NaN where nothing can be said.
    reduced_chi_square : float
        Squared distance over degrees of freedom; 1 is what measurement error explains. NaN without standard errors.
    degrees_of_freedom : float
        Independent level values less fitted parameters, over all specimens: as many as there are, or fewer where they
        were read off smoothed curves.
    specimens : tuple of SpecimenFit
        Each by itself.
    entries : tuple of FitEntry
        Every level value against the posterior predictive.
    pooling_p_value : float
        Chance that specimens which are alike differ by so much; NaN unless the posterior is pooled.
    displaced : tuple of FitEntry
        Where the simulated population lies beside the measured one.
    narrow : tuple of Narrow
        Where it scatters less than half as much, and not by chance, the worst first.
    excluded : tuple of ExcludedBy
        Priors that exclude the data.
    amplitude_unit : str
        m or rad.
    levels : array, shape (l,)
        Amplitudes.
    draws : array, shape (g, d, o, l)
        Simulated backbones of ``d`` draws, for every specimen (g = n) or for all of them (g = 1).

    See Also
    --------
    goodness_of_fit : makes one.
    findings : says the same beside what is wrong with the chains.
    plots.plot_fit : draws it.
    """

    likelihood: str
    p_value: float
    reduced_chi_square: float
    degrees_of_freedom: float
    specimens: tuple[SpecimenFit, ...]
    entries: tuple[FitEntry, ...]
    pooling_p_value: float = float("nan")
    displaced: tuple[FitEntry, ...] = ()
    narrow: tuple[Narrow, ...] = ()
    excluded: tuple[ExcludedBy, ...] = ()
    amplitude_unit: str = "m"
    levels: FloatArray = field(default_factory=lambda: np.zeros(0), repr=False)
    draws: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 0, 0)), repr=False)

    @property
    def bad_specimens(self) -> tuple[SpecimenFit, ...]:
        """Specimens that are not fitted even with parameters of their own."""
        count = max(len(self.specimens), 1)
        return tuple(one for one in self.specimens if one.p_value * count < SPECIMEN_LIMIT)

    @property
    def describes_specimens(self) -> bool:
        """Whether the model can describe every specimen; True where that cannot be checked."""
        return not (self.p_value < P_LIMIT or self.bad_specimens)

    @property
    def passes(self) -> bool:
        """Whether nothing speaks against the fit, and it could be checked."""
        is_pooled_rightly = not self.pooling_p_value < P_LIMIT
        return bool(np.isfinite(self.p_value)) and self.describes_specimens and is_pooled_rightly and not self.displaced

    @property
    def worst(self) -> FitEntry | None:
        """The level value that is furthest off in proportion, among those that stand out of their errors."""
        ranked = self.ranked()
        return ranked[0] if ranked else None

    def ranked(self) -> list[FitEntry]:
        """Return level values, the worst of every observable first, in the order of how far off they are."""
        finite = [entry for entry in self.entries if np.isfinite(entry.z)]
        outside = [entry for entry in finite if abs(entry.z) >= STANDS_OUT]
        if not outside:
            return sorted(finite, key=lambda entry: -abs(entry.z))[:1]
        # a trifle that is known very well must not stand before a gross error that is known less well
        first: dict[str, FitEntry] = {}
        for entry in sorted(outside, key=lambda entry: -abs(entry.relative)):
            first.setdefault(entry.observable, entry)
        return list(first.values())

    def as_dict(self) -> dict[str, Any]:
        """Return plain numbers and words, as ``result.json`` holds them."""
        worst = self.worst
        return {
            "passes": self.passes,
            "sentence": self.headline(),
            "likelihood": self.likelihood,
            "p_value": self.p_value,
            "reduced_chi_square": self.reduced_chi_square,
            "degrees_of_freedom": self.degrees_of_freedom,
            "pooling_p_value": self.pooling_p_value,
            "worst": None if worst is None else asdict(worst),
            "narrow": [asdict(one) for one in self.narrow],
            "prior_excludes": [asdict(one) for one in self.excluded],
            "specimens": [asdict(one) for one in self.specimens],
            "entries": [asdict(entry) for entry in self.entries],
        }

    def headline(self) -> str:
        """Say whether the model fits, without advice."""
        if self.passes or not np.isfinite(self.p_value):
            return self.sentence()
        if self.excluded:
            names = " and ".join(dict.fromkeys(one.parameter for one in self.excluded))
            return f"The prior of {names} excludes the data."
        if not self.describes_specimens:
            worst = self.worst
            where = "" if worst is None else f": {self.describe(worst)}"
            return f"The model does not fit{where}."
        if self.pooling_p_value < P_LIMIT:
            return "The model fits each specimen, but they differ by more than measurement error."
        return "The model fits each specimen, but the posterior lies beside the measured population."

    def sentence(self) -> str:
        """Say in one sentence whether the model fits."""
        if not np.isfinite(self.p_value):
            return "Whether the model fits cannot be checked: there are no more level values than parameters."
        if self.passes:
            return (
                "The model fits the measurement within its errors "
                f"({self._numbers()}; level values of {counted(len(self.specimens), 'specimen')})."
            )
        return self.sentences()[0]

    def sentences(self, remedy: str = REMEDY) -> list[str]:
        """Say what is wrong with the fit, the gravest first, each with what to do; empty if nothing is.

        Parameters
        ----------
        remedy : str, optional
            What to do about a model that lacks something.
        """
        if not np.isfinite(self.p_value):
            return [f"{self.sentence()[:-1]}; use more levels, or fix parameters."]
        found = [self._exclusion(one) for one in self.excluded]
        if not self.describes_specimens and not found:
            where = "; ".join(self.describe(entry) for entry in self.ranked())
            found.append(f"The model does not fit: {where} ({self._numbers()}): {remedy}.")
        bad = self.bad_specimens
        if bad and len(self.specimens) > 2 and 2 * len(bad) < len(self.specimens):
            names = ", ".join(f"{one.specimen} ({one.reduced_chi_square:.3g})" for one in bad)
            found.append(
                f"Not fitted even with parameters of its own: {names}, reduced chi-square in brackets; the other "
                "specimens are. Look at these records first."
            )
        if self.describes_specimens and self.pooling_p_value < P_LIMIT:
            found.append(
                f"The specimens differ by more than measurement error ({probability(self.pooling_p_value)} if they "
                "were alike): one parameter set for all of them is known less well than its posterior says; use the "
                "specimen or the population likelihood, or `build_hierarchical_model`."
            )
        if self.describes_specimens and self.displaced:
            where = "; ".join(self.describe(entry) for entry in self.displaced[:3])
            found.append(
                f"The posterior lies beside the measured population although the model can describe each specimen: "
                f"{where}. Widen the priors, or use another density."
            )
        if self.narrow:
            found.append(self._narrowness(self.narrow[0]))
        return found

    def _narrowness(self, one: Narrow) -> str:
        unit = OBSERVABLE_UNITS.get(one.observable, "1")
        unit = "" if unit == "1" else f" {unit}"
        return (
            f"The population comes out narrower than it was measured: {one.observable} at {one.level:.4g} "
            f"{self.amplitude_unit} has a standard deviation of {one.measured:.2g}{unit} over the specimens, of "
            f"{one.simulated:.2g}{unit} over the posterior. A product density counts levels that share their "
            "parameters as if each told something new; use the joint density."
        )

    def describe(self, entry: FitEntry) -> str:
        """Say how far off one level value is."""
        unit = OBSERVABLE_UNITS.get(entry.observable, "1")
        unit = "" if unit == "1" else f" {unit}"
        where = f"{entry.observable} at {entry.level:.4g} {self.amplitude_unit}"
        if entry.specimen is not None and len(self.specimens) > 1:
            where += f" of {entry.specimen}"
        digits = _digits(entry.measured, entry.predicted)
        return (
            f"{where} is {_against(entry)} what the model gives, {_number(entry.measured, digits)}{unit} measured, "
            f"{_number(entry.predicted, digits)}{unit} simulated"
        )

    def _numbers(self) -> str:
        shown = probability(self.p_value)
        if not np.isfinite(self.reduced_chi_square):
            return shown
        return f"reduced chi-square {self.reduced_chi_square:.3g}, {shown}"

    def _exclusion(self, one: ExcludedBy) -> str:
        worst = self.worst
        where = "" if worst is None else f": within it {self.describe(worst)}"
        return (
            f"The prior of {one.parameter} excludes the data{where}. The best fit ends at its {one.side} bound "
            f"{one.bound:.4g} and would go to {one.asked:.4g}; widen that prior."
        )


def probability(p: float) -> str:
    """Write a p-value; a tiny one is said to be tiny."""
    return "p < 0.001" if p < 0.001 else f"p = {p:.2g}"


def counted(number: int, noun: str) -> str:
    """Write a number of things."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _digits(*values: float) -> int:
    """Return how many digits keep values apart, three at least."""
    a, b = values
    if a == b or not (np.isfinite(a) and np.isfinite(b)):
        return 3
    apart = np.log10(max(abs(a), abs(b)) / abs(a - b))
    return int(np.clip(np.ceil(apart) + 2, 3, 9))


def _number(value: float, digits: int) -> str:
    """Write a number with so many significant digits, zeros at its end too."""
    text = f"{value:#.{digits}g}"
    return text.rstrip(".") if "e" not in text else f"{value:.{digits}g}"


def _against(entry: FitEntry) -> str:
    """Say a ratio as an engineer would: so many times, a tenth of, so many per cent above."""
    measured, predicted = entry.measured, entry.predicted
    if entry.observable == "offset" or measured * predicted <= 0.0:
        return "not"
    ratio = measured / predicted
    if ratio >= 1.75:
        return _times(ratio)
    if ratio <= 1.0 / 1.75:
        return f"1/{1.0 / ratio:.2g} of"
    return f"{abs(ratio - 1.0):.2%}".replace("%", " %") + (" above" if ratio > 1.0 else " below")


def _times(ratio: float) -> str:
    whole = round(ratio)
    if whole <= 10 and abs(ratio - whole) < 0.1 * whole:
        return "twice" if whole == 2 else f"{_TIMES[whole]} times"
    return f"{ratio:.3g} times"
