"""Simulation of free decays: backbones at levels, whole decays, and what is measured at given instants."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._common.checks import FloatArray, InputError, check_choice, check_finite_array, check_levels, check_positive
from ..oscillator import Oscillator
from . import kernels
from . import memory as layout
from .curves import cycles_of_decay
from .forces import KIND, OWN_EQUATION, describe_effects
from .halfcycle import COMPLETED
from .instants import DISPLACEMENT
from .machine_code import define
from .memory import Description, Turns, Waveform
from .results import BackboneResult, DecayResult, Status, WaveformResult
from .user_effects import compose_user_effects

TOLERANCE = 2e-9  # of one step, relative to amplitude and speed; set by the decrement, not by the frequency
MAXIMUM_TURNING_POINTS = 20_001
QUANTITIES = ("displacement", "velocity", "acceleration")
"""What can be sampled, by how often the displacement is differentiated."""
ALL_ROWS = (0, 1, 2)  # frequency, damping, offset


class Simulator:
    """An oscillator prepared for simulation: its effects looked up once, its arrays in the kernel's order.

    Parameters
    ----------
    oscillator : Oscillator
        What to simulate.
    is_relaxed : bool, default False
        Whether hysteretic states always start relaxed at the release, never loaded from rest.
    """

    def __init__(self, oscillator: Oscillator, *, is_relaxed: bool = False) -> None:
        define()
        self.oscillator, self.is_relaxed = oscillator, is_relaxed
        described = describe_effects(oscillator.effects)
        table = described.table
        self.user = compose_user_effects(described.users)
        self.needs_decay = described.n_states > 0
        self.has_own_equation = bool(np.any(table[:, KIND] == OWN_EQUATION))
        # Either takes several times as long as a slider: equations to integrate beside the motion, curves to work out.
        self.is_costly = self.has_own_equation or described.n_room > 0
        self._integers = np.zeros(layout.TABLE + table.size + described.rooms.size, dtype=np.int64)
        self._integers[layout.USER] = self.user
        self._integers[layout.N_EFFECTS] = len(table)
        self._integers[layout.STIFFNESS] = described.stiffness
        self._integers[layout.DAMPING] = described.damping
        self._integers[layout.N_STATES] = described.n_states
        self._integers[layout.N_ROOM] = described.n_room
        self._integers[layout.N_PARAMETERS] = len(oscillator.parameter_names)
        self._integers[layout.HAS_REGIME] = described.has_regime
        self._integers[layout.MAXIMUM] = MAXIMUM_TURNING_POINTS
        self._integers[layout.ROWS] = sum(1 << row for row in ALL_ROWS)
        self._integers[layout.TABLE :] = np.concatenate([table.ravel(), described.rooms.ravel()])

    def describe(
        self,
        levels: FloatArray | None = None,
        release: float = 0.0,
        virgin: bool = True,
        *,
        rows: tuple[int, ...] = ALL_ROWS,
        stop: float = 0.0,
        tolerance: float | None = None,
        whole: bool = True,
    ) -> Description:
        """Return a simulation in the layout that compiled code reads.

        Parameters
        ----------
        levels : ndarray, shape (l,), optional
            Amplitudes of a backbone [m or rad]; none for a decay.
        release : float, default 0.0
            Release [m or rad]; 0 lets the simulator choose, where a backbone is asked for.
        virgin : bool, default True
            Whether hysteretic states start loaded from rest.
        rows : tuple of int
            Which of frequency (0), damping (1), offset (2) are judged, where that is asked for.
        stop : float, default 0.0
            Amplitude at which a decay ends [m or rad]; 0 for never.
        tolerance : float, optional
            Of one step; default `TOLERANCE`.
        whole : bool, default True
            Whether all of the decay from a given release is run: the reference. Otherwise what can be jumped over is.
        """
        integers = self._integers.copy()
        integers[layout.BY_DECAY] = layout.BY_JUMPS if self.needs_decay else layout.BY_CYCLES
        if whole and release > 0.0:
            integers[layout.BY_DECAY] = layout.BY_WHOLE_DECAY
        integers[layout.VIRGIN] = virgin and not self.is_relaxed
        if rows != ALL_ROWS:
            integers[layout.ROWS] = sum(1 << row for row in rows)
        count = 0 if levels is None else levels.size
        integers[layout.N_LEVELS] = count
        numbers = np.zeros(layout.N_NUMBERS + count)
        numbers[layout.MASS] = self.oscillator.mass
        numbers[layout.TOLERANCE] = TOLERANCE if tolerance is None else tolerance
        numbers[layout.RELEASE] = release
        numbers[layout.STOP] = stop
        if levels is not None:
            numbers[layout.N_NUMBERS :] = levels
        return Description(integers, numbers)

    def backbone(
        self,
        parameters: FloatArray,
        levels: FloatArray,
        release: float,
        virgin: bool,
        values: FloatArray,
        jacobian: FloatArray,
        status: NDArray[np.int64],
        *,
        whole: bool = True,
    ) -> None:
        """Run the compiled backbone into ``values``, ``jacobian`` (empty: not wanted) and ``status``."""
        kernels.backbone(*self.describe(levels, release, virgin, whole=whole), parameters, values, jacobian, status)

    def decay(
        self,
        parameters: FloatArray,
        release: float,
        turns: Turns,
        waveform: Waveform | None = None,
        *,
        virgin: bool = True,
        stop: float = 0.0,
        tolerance: float | None = None,
    ) -> tuple[int, int]:
        """Run the compiled whole decay into ``turns`` and ``waveform``; return how many turning points, and the status.

        Derivatives with respect to the parameters are carried where `make_turns` was asked for them.
        """
        description = self.describe(None, release, virgin, stop=stop, tolerance=tolerance)
        count, code = kernels.decay(*description, parameters, turns, _NO_WAVEFORM if waveform is None else waveform)
        return int(count), int(code)

    def waveform(
        self,
        parameters: FloatArray,
        release: float,
        instants: FloatArray,
        quantity: int,
        *,
        virgin: bool = True,
        sensitivities: bool = True,
        tolerance: float | None = None,
        maximum: int = MAXIMUM_TURNING_POINTS,
    ) -> tuple[FloatArray, FloatArray, int]:
        """Return a derivative of the displacement, ``quantity`` times, at ascending instants since the release.

        Returns its values (n,), their derivatives (n, 2 + p) with respect to release amplitude, parameters and time (no
        columns where they are not wanted), and the status. At negative instants the oscillator is held.
        """
        before = int(np.searchsorted(instants, 0.0, side="left"))
        values = np.full(instants.size, release if quantity == DISPLACEMENT else 0.0)
        slopes = np.zeros((instants.size, parameters.size + 2 if sensitivities else 0))
        if sensitivities and quantity == DISPLACEMENT:
            slopes[:before, 0] = 1.0
        code = int(COMPLETED)
        if before < instants.size:
            later = np.ascontiguousarray(instants[before:])
            room = Waveform(later, values[before:], slopes[before:], quantity)
            turns = self.make_turns(maximum, sensitivities)
            _, code = self.decay(parameters, release, turns, room, virgin=virgin, tolerance=tolerance)
        return values, slopes, code

    def make_turns(self, maximum: int, sensitivities: bool) -> Turns:
        """Return room for so many turning points, and for derivatives with respect to the parameters if wanted."""
        columns = 0 if self.has_own_equation else 1
        if sensitivities:
            columns = len(self.oscillator.parameter_names) + 1
        shape = (maximum, columns)
        return Turns(np.empty(maximum), np.empty(maximum), np.empty(shape), np.empty(shape))


_NO_WAVEFORM = Waveform(np.empty(0), np.empty(0), np.empty((0, 0)), DISPLACEMENT)


def simulate_backbone(
    oscillator: Oscillator,
    parameters: ArrayLike | dict[str, float],
    levels: ArrayLike,
    *,
    release_amplitude: float | None = None,
    virgin: bool = True,
    sensitivities: bool = False,
) -> BackboneResult:
    """Simulate the backbone of an oscillator at amplitude levels.

    Without internal states a turning point is described by its amplitude alone, so each level needs one cycle,
    whose starting peak Newton's method finds; with states (hysteresis) the decay is run and read off between its
    cycles by local cubics in log amplitude. Where the decay is long and the oscillator its own mirror image, a few
    cycles at each level are run, with the past that they would have, and those in between are left out.

    Parameters
    ----------
    oscillator : Oscillator
        Mass and effects.
    parameters : array_like, shape (p,), or dict
        Parameter values, in the order of ``oscillator.parameter_names``.
    levels : array_like, shape (l,)
        Amplitudes [m or rad], strictly increasing and positive.
    release_amplitude : float, optional
        Start of the decay [m or rad]. Given, the whole decay is run, every cycle of it (the reference path).
        Default: one cycle per level, or 1.25 times the highest level where states remember.
    virgin : bool, default True
        Whether hysteretic states start loaded from rest up to the release, or relaxed at the release.
    sensitivities : bool, default False
        Whether to compute derivatives with respect to the parameters.

    Returns
    -------
    BackboneResult
        Values (3, l), status (l,), and derivatives (3, l, p) if wanted.

    Raises
    ------
    InputError
        Levels not positive and increasing, or parameters that do not fit the oscillator.

    See Also
    --------
    simulate_decay : the whole decay, cycle by cycle.
    simulate_waveform : the motion itself.
    simulate_population : many specimens.

    Notes
    -----
    Dormand-Prince 8(5,3), adaptive, with local error 3e-10 of amplitude and speed.

    Examples
    --------
    >>> import numpy as np
    >>> from pymc_backbone import Oscillator, simulate_backbone
    >>> linear = Oscillator(mass=1.0, effects=())
    >>> result = simulate_backbone(linear, {"linear_stiffness": 400.0, "viscous_damping": 0.4}, [0.01, 0.1])
    >>> print(np.round(result.frequency, 6))
    [3.18294 3.18294]
    """
    checked = check_levels(levels)
    vector = oscillator.pack(parameters)
    values = np.empty((3, checked.size))
    jacobian = np.zeros((3, checked.size, vector.size) if sensitivities else (0, 0, 0))
    status = np.zeros(checked.size, dtype=np.int64)
    release = 0.0 if release_amplitude is None else check_positive("release_amplitude", release_amplitude)
    Simulator(oscillator).backbone(vector, checked, release, virgin, values, jacobian, status)
    return BackboneResult(checked, values, status, jacobian if sensitivities else None)


def simulate_decay(
    oscillator: Oscillator,
    parameters: ArrayLike | dict[str, float],
    release_amplitude: float,
    *,
    n_cycles: int | None = None,
    stop_amplitude: float | None = None,
    virgin: bool = True,
) -> DecayResult:
    """Simulate a whole free decay, cycle by cycle.

    Parameters
    ----------
    oscillator : Oscillator
        Mass and effects.
    parameters : array_like, shape (p,), or dict
        Parameter values.
    release_amplitude : float
        Displacement at release, at rest [m or rad]; positive.
    n_cycles : int, optional
        How many cycles; default: until ``stop_amplitude``.
    stop_amplitude : float, optional
        The decay ends when its amplitude is below this [m or rad]; default 1e-3 of the release.
    virgin : bool, default True
        Whether hysteretic states start loaded from rest up to the release, or relaxed at the release.

    Returns
    -------
    DecayResult
        Cycle quantities, turning points and why the decay ended.

    Raises
    ------
    InputError
        A release or a number of cycles that is not positive, or parameters that do not fit the oscillator.

    See Also
    --------
    simulate_backbone : at given amplitudes.
    simulate_waveform : the motion itself.
    """
    release = check_positive("release_amplitude", release_amplitude)
    vector = oscillator.pack(parameters)
    stop = 1e-3 * release if stop_amplitude is None else check_positive("stop_amplitude", stop_amplitude)
    maximum = MAXIMUM_TURNING_POINTS
    if n_cycles is not None:
        if n_cycles < 1:
            raise InputError(f"`n_cycles` must be at least 1, got {n_cycles}.")
        maximum = 2 * int(n_cycles) + 1
        stop = 0.0 if stop_amplitude is None else stop
    simulator = Simulator(oscillator)
    turns = simulator.make_turns(maximum, False)
    count, code = simulator.decay(vector, release, turns, virgin=virgin, stop=stop)
    cycles = np.empty((maximum // 2 + 1, 4))
    found = 0
    if count >= 3:
        found = cycles_of_decay(
            turns.values, turns.times, turns.slopes, turns.time_slopes, count, 0, cycles,
            np.empty((maximum // 2 + 1, 4, 0)),
        )  # fmt: skip
    peaks = turns.times[0:count:2]
    return DecayResult(
        time=0.5 * (peaks[:found] + peaks[1 : found + 1]),
        amplitude=cycles[:found, 0].copy(),
        frequency=cycles[:found, 1].copy(),
        damping=cycles[:found, 2].copy(),
        offset=cycles[:found, 3].copy(),
        turning_times=turns.times[:count].copy(),
        turning_values=turns.values[:count].copy(),
        status=Status(code),
    )


def simulate_waveform(
    oscillator: Oscillator,
    parameters: ArrayLike | dict[str, float],
    time: ArrayLike,
    release_amplitude: float,
    *,
    release_time: float = 0.0,
    virgin: bool = True,
    sensitivities: bool = False,
    quantity: str = "displacement",
) -> WaveformResult:
    """Simulate displacement, velocity or acceleration of a free decay at given instants.

    Parameters
    ----------
    oscillator : Oscillator
        Mass and effects.
    parameters : array_like, shape (p,), or dict
        Parameter values.
    time : array_like, shape (n,)
        Instants [s], not decreasing.
    release_amplitude : float
        Displacement at release, at rest [m or rad]; not zero, either sign.
    release_time : float, default 0.0
        Instant of release [s]; before it the displacement is ``release_amplitude``, velocity and acceleration are zero.
    virgin : bool, default True
        Whether hysteretic states start loaded from rest up to the release, or relaxed at the release.
    sensitivities : bool, default False
        Whether to compute derivatives with respect to the parameters, the release amplitude and time.
    quantity : {"displacement", "velocity", "acceleration"}
        What a sensor would measure.

    Returns
    -------
    WaveformResult
        The quantity (n,) and, if wanted, its derivatives.

    Raises
    ------
    InputError
        Time that runs backwards, a release of zero, an unknown quantity, or parameters that do not fit the oscillator.

    See Also
    --------
    simulate_decay : the quantities of its cycles.
    simulate_backbone : at given amplitudes.

    Notes
    -----
    Between the integrator's steps the septic through position, velocity, acceleration and jerk is used, for the
    derivatives the quintic without jerk. The velocity is that polynomial's derivative; the acceleration follows from
    the equation of motion at the state between the steps, with the direction of the half cycle: where friction makes it
    jump, at a turning point, the instant itself belongs to the half cycle before.
    """
    check_choice("quantity", quantity, QUANTITIES)
    instants = check_finite_array("time", time) - release_time
    backwards = np.flatnonzero(np.diff(instants) < 0.0)
    if backwards.size:
        raise InputError(f"`time` must not run backwards, got a drop after time[{backwards[0]}]. Sort the instants.")
    release = float(release_amplitude)
    if not np.isfinite(release) or release == 0.0:
        raise InputError(f"`release_amplitude` must be finite and not zero, got {release_amplitude}.")
    vector = oscillator.pack(parameters)
    simulator = Simulator(oscillator)
    values, slopes, code = simulator.waveform(
        vector, release, instants, QUANTITIES.index(quantity), virgin=virgin, sensitivities=sensitivities
    )
    if not sensitivities:
        return WaveformResult(values, None, None, None, Status(code), quantity)
    release_slope, jacobian, time_slope = (np.ascontiguousarray(slopes[:, part]) for part in (0, slice(1, -1), -1))
    return WaveformResult(values, jacobian, release_slope, time_slope, Status(code), quantity)
