"""What a tool said about each batch, held against the truth."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from meanings import WORDS, Meaning, meaning_of
from scipy.optimize import minimize
from scipy.special import expit
from systems import LIBRARY_NAMES_OF_OUTSIDE, NEW

OUTCOMES = ("right", "mechanism", "listed", "wrong", "adequate", "unexplained", "ambiguous", "refused", "no result")
"""``listed``: ambiguous, the truth among the sets; ``ambiguous``: the truth not among them; ``mechanism``: no law is
named, but its mechanism is; ``wrong``: another name, said with confidence. Where nothing is missing, ``adequate`` is
the right answer and any name is wrong."""

NAMED_FROM = 0.95
LEAST_SHARE = 0.05
"""Probability and share of the gap from which the tool names a mechanism."""
TOLD_FROM = 0.05
"""Probability from which a law of a mechanism counts as told beside it."""
ALWAYS_THERE = frozenset(("linear_stiffness", "viscous_damping"))


@dataclass(frozen=True)
class Outcome:
    """One batch: truth, distance to the nearest explanation without the hidden effects, and what the tool said.

    Attributes
    ----------
    distance : float
        Standard deviations between the data and the nearest other explanation; NaN where unknown.
    hidden : tuple of str
        In the package's names; what the base imitates exactly is not among them.
    outcome : str
        One of `OUTCOMES`.
    is_kindred : bool
        Whether a wrong name is that of laws whose mechanisms may rightly be named.
    is_listed : bool
        Whether the truth is among the sets that remain possible, whatever is named.
    is_told : bool
        Whether the verdict is a mechanism and the truth's laws are all told among those of its mechanisms.
    certain : str
        What mechanisms are certain, whatever the verdict: ``right``, ``wrong`` or ``none``; a law's name counts as its
        mechanisms.
    covered : tuple of bool
        Whether the 95 % interval of each parameter of a right law holds its mean over the specimens.
    probability : float
        Of the most probable set; NaN where the tool gave none.
    is_top_right : bool
        Whether the most probable set is the truth.
    is_top_empty : bool
        Whether the most probable set is the model as it is.
    gap : dict
        As the tool wrote it; empty where it wrote none.
    contaminations : tuple of str
        What disturbs the records beside the hidden effect.
    outside : str
        The law that was drawn as one outside of the library; empty for none.
    """

    folder: str
    tier: str
    base: tuple[str, ...]
    hidden: tuple[str, ...]
    is_in_library: bool
    strength: dict[str, float]
    distance: float
    outcome: str
    is_kindred: bool
    is_listed: bool
    is_told: bool
    certain: str
    covered: tuple[bool, ...]
    named: tuple[str, ...]
    probability: float
    is_top_right: bool
    is_top_empty: bool
    gap: dict[str, Any]
    seconds: float
    contaminations: tuple[str, ...] = ()
    outside: str = ""

    @property
    def group(self) -> str:
        """What kind of question the batch asked."""
        if not self.is_in_library:
            return "outside"
        if not self.hidden:
            return "nothing"
        if not NEW.keys().isdisjoint(self.hidden):
            return "variant"
        if self.base:
            return "base plus hidden"
        return {1: "one effect", 2: "two effects"}.get(len(self.hidden), "three effects")

    @property
    def has_empty_truth(self) -> bool:
        """Whether nothing at all is missing."""
        return self.group == "nothing"


def read_outcomes(folder: Path) -> list[Outcome]:
    """Read truth, distance and result of every batch in a folder.

    Parameters
    ----------
    folder : Path
        Holds ``batch_*/truth.json`` and, where they were written, ``distance.json`` and ``result.json`` beside it.

    Returns
    -------
    list of Outcome
        In the order of the folders' names.

    Raises
    ------
    FileNotFoundError
        If there is no batch.
    """
    paths = sorted(folder.glob("batch_*/truth.json"))
    if not paths:
        raise FileNotFoundError(f"{folder} holds no batch_*/truth.json. Run generate.py first.")
    return [_judge(path.parent) for path in paths]


def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else math.nan


def _names(entries: Any, base: frozenset[str]) -> frozenset[str]:
    """Return names of effects, given as text or as records with a name, without those that the base holds."""
    found = (entry["name"] if isinstance(entry, dict) else str(entry) for entry in entries or ())
    return frozenset(found) - base


def _judge(folder: Path) -> Outcome:
    truth, said = _read(folder / "truth.json"), _read(folder / "result.json")
    held = frozenset(truth["base"]) | ALWAYS_THERE
    meaning = meaning_of(truth)
    named = _names(said.get("missing_effects"), held)
    listed = {_names(names, held) for names in said.get("ambiguous_sets") or ()}
    outcome = _classify(said.get("verdict"), named, listed, meaning)
    is_kindred = outcome == "wrong" and meaning.is_kindred(named)
    if said.get("verdict") == "found" and said.get("named_level") == "mechanism":
        outcome, is_kindred = "mechanism" if meaning.allows(_certain_kinds(said)) else "wrong", False
    candidates = [(_number(c.get("probability")), _names(c.get("effects"), held)) for c in said.get("candidates") or ()]
    candidates = [candidate for candidate in candidates if not math.isnan(candidate[0])]
    top = max(candidates, key=lambda candidate: candidate[0], default=(_number(said.get("probability")), named))
    given = _number(said.get("probability"))
    return Outcome(
        folder=folder.name,
        tier=truth["tier"],
        base=tuple(sorted(truth["base"])),
        hidden=tuple(sorted(meaning.hidden)),
        is_in_library=meaning.is_in_library,
        strength=_strength(truth),
        distance=_number(_read(folder / "distance.json").get("distance")),
        outcome=outcome,
        is_kindred=is_kindred,
        is_listed=bool(listed & meaning.accepted),
        is_told=outcome == "mechanism" and any(names <= _told(said) for names in meaning.accepted if names),
        certain=_of_certain(said, named, meaning),
        covered=_covered(truth, said) if outcome == "right" else (),
        named=tuple(sorted(named)),
        probability=top[0] if math.isnan(given) else given,
        is_top_right=top[1] in meaning.accepted,
        is_top_empty=not top[1],
        gap=dict(said.get("gap") or {}),
        seconds=_number(said.get("seconds")),
        contaminations=tuple(sorted(truth.get("contaminations") or ())),
        outside=truth.get("outside") or "",
    )


def _certain_kinds(said: dict[str, Any]) -> set[str]:
    """Return the mechanisms that are probable enough for a name, and explain enough to be worth one."""
    return {
        item["mechanism"]
        for item in said.get("mechanisms") or ()
        if item["probability"] >= NAMED_FROM and item["share_of_gap"] >= LEAST_SHARE
    }


def _told(said: dict[str, Any]) -> frozenset[str]:
    """Return the laws that the verdict tells with their probabilities among those of mechanisms."""
    laws = (law for item in said.get("mechanisms") or () for law in item["laws"])
    return frozenset(law["effect"] for law in laws if law["probability"] >= TOLD_FROM)


def _of_certain(said: dict[str, Any], named: frozenset[str], meaning: Meaning) -> str:
    """Return whether the mechanisms that are certain, or those of the law that is named, may rightly be named."""
    if named and named in meaning.accepted:  # whatever mechanism its coefficients make of a law
        return "right"
    kinds = {WORDS.get(name, "other") for name in named} if named else _certain_kinds(said)
    if not kinds:
        return "none"
    return "right" if meaning.allows(kinds) else "wrong"


def _as_fitted(specimen: dict[str, Any]) -> dict[str, Any]:
    """Return the parameters of a specimen as the package knows them, which takes A for 1 and alpha for 0.

    With ``z = A u`` the same force is ``(1 - alpha) A k u``, and ``u' = x' - A^(n - 1) (beta ... + gamma ...)``.
    """
    if "bouc_wen_stiffness" not in specimen:
        return specimen
    scale = specimen.get("bouc_wen_amplitude", 1.0)
    shape = scale ** (specimen["bouc_wen_exponent"] - 1.0)
    return specimen | {
        "bouc_wen_stiffness": (1.0 - specimen.get("bouc_wen_alpha", 0.0)) * scale * specimen["bouc_wen_stiffness"],
        "bouc_wen_beta": shape * specimen["bouc_wen_beta"],
        "bouc_wen_gamma": shape * specimen["bouc_wen_gamma"],
    }


def _covered(truth: dict[str, Any], said: dict[str, Any]) -> tuple[bool, ...]:
    """Return whether each interval of a named effect's parameters holds the mean over the specimens."""
    held = []
    for effect in said.get("missing_effects") or ():
        for name, estimate in (effect.get("parameters") or {}).items():
            drawn = [_as_fitted(specimen)[name] for specimen in truth.get("parameters") or () if name in specimen]
            if drawn and estimate["sd"] > 0.0:
                held.append(bool(estimate["hdi_low"] <= float(np.mean(drawn)) <= estimate["hdi_high"]))
    return tuple(held)


def _strength(truth: dict[str, Any]) -> dict[str, float]:
    """Return the strengths by the package's names."""
    held = truth.get("strength") or {}
    return {LIBRARY_NAMES_OF_OUTSIDE.get(name, name): float(value) for name, value in held.items()}


def _classify(verdict: str | None, named: frozenset[str], listed: set[frozenset[str]], meaning: Meaning) -> str:
    """Return one of `OUTCOMES`."""
    if verdict is None:
        return "no result"
    if verdict == "found":
        return "right" if named and named in meaning.accepted else "wrong"
    if verdict == "ambiguous":
        return "listed" if listed & meaning.accepted else "ambiguous"
    if verdict in ("adequate", "unexplained"):
        return verdict
    if verdict in ("refused", "failed"):  # one sentence instead of a verdict, or a fault of the tool
        return "refused"
    raise ValueError(f"`verdict` must be adequate, found, ambiguous or unexplained, got {verdict!r}.")


def wilson_interval(successes: int, count: int, z: float = 1.96) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share."""
    if count == 0:
        return math.nan, math.nan
    share = successes / count
    middle = share + z**2 / (2.0 * count)
    half = z * math.sqrt(share * (1.0 - share) / count + z**2 / (4.0 * count**2))
    scale = 1.0 + z**2 / count
    return max(0.0, (middle - half) / scale), min(1.0, (middle + half) / scale)


def logistic_thresholds(values: np.ndarray, successes: np.ndarray, shares: tuple[float, ...]) -> tuple[float, ...]:
    """Return where a logistic curve in the logarithm of ``values`` reaches given shares.

    Parameters
    ----------
    values : ndarray, shape (n,)
        Positive.
    successes : ndarray of bool, shape (n,)
    shares : tuple of float
        Between 0 and 1.

    Returns
    -------
    tuple of float
        NaN where there are fewer than six batches, only one kind of outcome, or no rise.

    Notes
    -----
    The slope has a weak normal prior (standard deviation 5 per e-fold), so that separated data give finite figures.
    """
    usable = np.isfinite(values) & (values > 0.0)
    x, y = np.log(values[usable]), successes[usable].astype(float)
    if x.size < 6 or y.min() == y.max():
        return tuple(math.nan for _ in shares)
    centre = float(x.mean())

    def loss(theta: np.ndarray) -> float:
        eta = theta[0] + theta[1] * (x - centre)
        return float(np.sum(np.logaddexp(0.0, eta) - y * eta) + 0.5 * (theta[1] / 5.0) ** 2)

    def slope(theta: np.ndarray) -> np.ndarray:
        rest = expit(theta[0] + theta[1] * (x - centre)) - y
        return np.array([rest.sum(), rest @ (x - centre) + theta[1] / 25.0])

    level, rise = minimize(loss, np.array([0.0, 1.0]), jac=slope, method="BFGS").x
    if rise <= 0.05:
        return tuple(math.nan for _ in shares)
    return tuple(float(math.exp(centre + (math.log(q / (1.0 - q)) - level) / rise)) for q in shares)
