"""What an Op simulates: an oscillator at fixed levels, or any function that returns a backbone."""

from __future__ import annotations

import functools
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from hashlib import sha256

import numpy as np
import pytensor
from numpy.typing import ArrayLike

from .._common.checks import OBSERVABLES, FloatArray, InputError, check_levels, check_observables, check_positive
from .._common.compiled import compiled_sources_digest
from ..oscillator import Oscillator
from .counts import FAILURES, GRADIENTS, REMEMBERED, SIMULATIONS, count
from .decay import Simulator
from .many import simulate_many

logger = logging.getLogger("pymc_backbone")
# Parameter vectors that are remembered. A walk asks for the next point and the present one: of three, the one not asked
# for longest is neither; of two, a second rejection in a row would drop the present one.
MEMORY = 3


@dataclass(frozen=True)
class OscillatorResponse:
    """The backbone of an oscillator at fixed levels, as an Op sees it: plain, hashable, picklable data.

    Parameters
    ----------
    oscillator : Oscillator
        Mass and effects.
    levels : tuple of float
        Amplitudes [m or rad].
    observables : tuple of str
        Which of frequency, damping, offset.
    release_amplitude : float, default 0.0
        Release of the whole decay [m or rad]; 0 lets the simulator choose.
    virgin : bool, default True
        Whether hysteretic states start loaded from rest.
    """

    oscillator: Oscillator
    levels: tuple[float, ...]
    observables: tuple[str, ...]
    release_amplitude: float = 0.0
    virgin: bool = True

    has_gradient = True

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return self.oscillator.parameter_names

    @property
    def rows(self) -> tuple[int, ...]:
        """Which rows of the simulator's table are wanted."""
        return tuple(OBSERVABLES.index(name) for name in self.observables)

    @property
    def key(self) -> str:
        """Digest of everything the numbers depend on: the description, every compiled source, user effects."""
        text = repr(
            (self.oscillator.mass, self.levels, self.observables, self.release_amplitude, self.virgin,
             [effect.name for effect in self.oscillator.effects])
        )  # fmt: skip
        parts = (text, self.oscillator.source_digest(), compiled_sources_digest(), pytensor.__version__)
        return sha256("\0".join(parts).encode()).hexdigest()

    def evaluate(self, theta: FloatArray, wanted: bool) -> tuple[FloatArray, FloatArray, bool]:
        """Return values (o, l), derivatives (o, l, p) (empty if not wanted) and whether every level completed."""
        simulator = simulator_of(self.oscillator)
        levels = np.array(self.levels)
        values = np.empty((3, levels.size))
        jacobian = np.empty((3, levels.size, theta.size) if wanted else (0, 0, 0))
        status = np.zeros(levels.size, dtype=np.int64)
        simulator.backbone(theta, levels, self.release_amplitude, self.virgin, values, jacobian, status)
        count(GRADIENTS if wanted else SIMULATIONS, 1)
        if status.any():
            count(FAILURES, 1)
        rows = list(self.rows)
        return values[rows], jacobian[rows] if wanted else jacobian, not status.any()

    def evaluate_many(self, theta: FloatArray) -> FloatArray:
        """Return values (n, o, l) of many parameter vectors (n, p), on all cores; NaN where a level fails."""
        simulator = simulator_of(self.oscillator)
        values, status = simulate_many(simulator, theta, np.array(self.levels), self.release_amplitude, self.virgin)
        count(SIMULATIONS, len(values))
        count(FAILURES, int(status.any(axis=1).sum()))
        return values[:, list(self.rows)]


@functools.lru_cache(maxsize=64)
def simulator_of(oscillator: Oscillator) -> Simulator:
    """Return the prepared simulator of ``oscillator``, kept for the next call."""
    return Simulator(oscillator)


@dataclass(frozen=True)
class CallableResponse:
    """Any function that returns a backbone, standing in for an oscillator; no gradient.

    Parameters
    ----------
    function : callable
        ``function(parameters, levels) -> values``: a dict from parameter name to float, the levels (l,) and the
        values (o, l) with one row per observable. NaN counts as a failed simulation, and so does an arithmetic error, a
        ValueError or a RuntimeError, of which the first of each kind is logged as a warning. Must be importable
        (defined at the top of a module) where several processes sample.
    parameter_names : tuple of str
        Names of the parameters, in order.
    levels : tuple of float
        Amplitudes [m or rad].
    observables : tuple of str
        Which of frequency, damping, offset the rows are.

    Notes
    -----
    The last few parameter vectors are remembered with what the function returned for them: it may be slow, and PyMC's
    steps ask for the present point again with every proposal.
    """

    function: Callable[[dict[str, float], FloatArray], ArrayLike]
    parameter_names: tuple[str, ...]
    levels: tuple[float, ...]
    observables: tuple[str, ...]
    _known: dict[bytes, FloatArray] = field(default_factory=dict, init=False, repr=False, compare=False)
    _said: set[str] = field(default_factory=set, init=False, repr=False, compare=False)

    has_gradient = False

    def evaluate(self, theta: FloatArray, wanted: bool) -> tuple[FloatArray, FloatArray, bool]:
        """Return values (o, l), an empty array, and whether the function returned finite values."""
        key = theta.tobytes()
        values = self._known.pop(key, None)
        if values is None:
            values = self._call(theta)
            count(SIMULATIONS, 1)
            count(FAILURES, 0 if np.isfinite(values).all() else 1)
        else:
            count(REMEMBERED, 1)
        self._known[key] = values
        while len(self._known) > MEMORY:
            self._known.pop(next(iter(self._known)))
        return values.copy(), np.empty((0, 0, 0)), bool(np.isfinite(values).all())

    def evaluate_many(self, theta: FloatArray) -> FloatArray:
        """Return values (n, o, l) of many parameter vectors (n, p), in turn; NaN where the function fails."""
        values = [self.evaluate(np.ascontiguousarray(row), False)[0] for row in theta]
        return np.array(values).reshape(len(values), len(self.observables), len(self.levels))

    def _call(self, theta: FloatArray) -> FloatArray:
        """Return what the function says, NaN where it fails."""
        shape = (len(self.observables), len(self.levels))
        parameters = dict(zip(self.parameter_names, theta.tolist(), strict=True))
        try:
            given = np.asarray(self.function(dict(parameters), np.array(self.levels)))
            if np.iscomplexobj(given):
                raise InputError(
                    "the backbone function must return real numbers, got complex ones; return what is measured, for "
                    "example the absolute value of an eigenvalue over 2 pi."
                )
            values = given.astype(np.float64)
        except InputError:
            raise
        except (ArithmeticError, ValueError, RuntimeError, np.linalg.LinAlgError) as error:
            self._say(error, parameters)
            return np.full(shape, np.nan)
        if values.shape != shape:
            raise InputError(
                f"the backbone function must return an array of shape {shape} (observables, levels), "
                f"got {values.shape}."
            )
        return values

    def _say(self, error: Exception, parameters: dict[str, float]) -> None:
        """Warn of the first error of each kind; the points where it fails are counted as failures."""
        kind = type(error).__name__
        if kind not in self._said:
            self._said.add(kind)
            where = ", ".join(f"{name} = {value:.6g}" for name, value in parameters.items())
            logger.warning(
                "the backbone function raised %s (%s) at %s; such points have no likelihood and count as failures",
                kind, error, where,
            )  # fmt: skip


Response = OscillatorResponse | CallableResponse


def make_response(
    source: Oscillator | Callable[[dict[str, float], FloatArray], ArrayLike],
    levels: ArrayLike,
    observables: str | Sequence[str] = ("frequency", "damping"),
    *,
    parameter_names: Sequence[str] | None = None,
    release_amplitude: float | None = None,
    virgin: bool = True,
) -> Response:
    """Describe an oscillator, or any function that returns a backbone, as an Op sees it.

    Parameters
    ----------
    source : Oscillator or callable
        What is simulated; see `CallableResponse` for what a function must return.
    levels : array_like, shape (l,)
        Amplitudes [m or rad].
    observables : sequence of str
        Any of frequency, damping, offset.
    parameter_names : sequence of str, optional
        For a function: the names of its parameters, in order.
    release_amplitude, virgin
        For an oscillator: as in `simulate_backbone`.

    Returns
    -------
    OscillatorResponse or CallableResponse

    Raises
    ------
    InputError
        Levels or observables that cannot be used, or a function without parameter names.
    """
    checked = tuple(check_levels(levels).tolist())
    names = check_observables(observables)
    if isinstance(source, Oscillator):
        release = 0.0 if release_amplitude is None else check_positive("release_amplitude", release_amplitude)
        return OscillatorResponse(source, checked, names, release, virgin)
    if not callable(source):
        raise InputError(f"the model must be an Oscillator or a function, got {type(source).__name__}.")
    if not parameter_names:
        raise InputError("a backbone function needs `parameter_names`: the names of its parameters, in order.")
    return CallableResponse(source, tuple(parameter_names), checked, names)
