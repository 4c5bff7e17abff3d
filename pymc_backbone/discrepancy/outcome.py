"""What a finished search comes to: the decision, the fits that it is told of, the checks on the data."""

from __future__ import annotations

from dataclasses import dataclass

from .checks import data_checks, rivals
from .checks.verify import Verification
from .deciding.decision import AGREE, Decision
from .deciding.tolerance import is_drift_small
from .fitting.batch import Batch
from .fitting.curves import has_mid_line, level_chi_square
from .fitting.joint_fit import Fit
from .results.entries import Check
from .results.verdict import Verdict
from .sets.question import Question
from .sets.search import Search


@dataclass(frozen=True, eq=False)
class Outcome:
    """A finished search, what is decided on it, and the rivals of an effect that were looked at.

    Attributes
    ----------
    search : Search
        All sets and their fits.
    decision : Decision
        The verdict and what it rests on.
    drifting : Fit or None
        The base with a drift in time; None without records.
    second_mode : Check
        Whether a second mode beats in the records.
    ambient : Check
        Whether something goes on moving the structures.
    """

    search: Search
    decision: Decision
    drifting: Fit | None
    second_mode: Check
    ambient: Check

    @property
    def base(self) -> Fit:
        """The fit of the model as it is."""
        return self.search.fits[()]

    @property
    def extended(self) -> Fit | None:
        """The fit of the model with the best set; None where that is empty."""
        return self.model if self.decision.best else None

    @property
    def model(self) -> Fit:
        """The fit that is believed: the extended one, or the base."""
        return self.decision.on_backbones or self.search.fits[self.decision.model]

    @property
    def judged(self) -> Batch:
        """What it is judged by: the backbones alone where no fit keeps the phase of the records."""
        batch = self.search.batch
        return batch if self.decision.on_backbones is None else batch.without_records()


def checks_of(question: Question, outcome: Outcome, verification: Verification) -> tuple[Check, ...]:
    """Return the checks on the data: explanations that are no effect."""
    batch, decision = question.batch, outcome.decision
    # where a drift is the answer it is told for the base, beside what is none of it with its probability
    is_drift = decision.drift_probability > 0.5
    named = outcome.model if decision.model in decision.drifts and not (is_drift and decision.best) else None
    if is_drift and not decision.best:
        named = outcome.drifting
    reduced = verification.reduced
    if not decision.is_approximate:  # the samples speak for it: each value of the backbones may speak against it
        reduced = min(reduced, level_chi_square(outcome.judged, outcome.model, is_apart=True))
    return (
        rivals.drift_check(
            outcome.drifting,
            decision.drift_probability,
            bool(decision.best),
            named,
            is_small=named is not None and is_drift_small(named, question.tolerance),
            settling=batch.settling_time,
        ),
        outcome.second_mode,
        data_checks.one_decay_check(
            batch, outcome.model, is_exact=not decision.is_approximate, is_moved=not outcome.ambient.passed
        ),
        data_checks.alike_check(batch, outcome.model, is_exact=not decision.is_approximate),
        data_checks.data_terms_check(
            outcome.judged,
            reduced,
            AGREE,
            before=level_chi_square(outcome.judged, verification.before),
            is_exact=not decision.is_approximate,
            is_explained=bool(decision.best) or decision.verdict is not Verdict.UNEXPLAINED,
            is_drifting=not decision.model and () in decision.drifts,
            is_of_two_sides=has_mid_line(batch, outcome.model),
        ),
        outcome.ambient,
    )


__all__ = ["Outcome", "checks_of"]
