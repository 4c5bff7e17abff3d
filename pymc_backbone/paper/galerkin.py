"""A cantilever with point masses: natural modes, and the reduction to one mode by Galerkin's integrals."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import quad

from .._common.checks import FloatArray, InputError, check_positive
from .beam_modes import ModeShape, exact_modes

Shape = Callable[..., FloatArray]


@dataclass(frozen=True)
class PointMass:
    """A mass that moves with one point of the beam; its rotation is left out.

    Attributes
    ----------
    mass : float
        Mass [kg].
    position : float
        Distance from the clamp [m].

    See Also
    --------
    paper.CantileverBeam : what carries it.
    """

    mass: float
    position: float

    def __post_init__(self) -> None:
        check_positive("mass", self.mass)
        check_positive("position", self.position)


@dataclass(frozen=True)
class CantileverBeam:
    """A uniform cantilever of rectangular section, clamped at x = 0, with point masses.

    Attributes
    ----------
    length, width, thickness : float
        Dimensions [m]; bending is about the axis along the width.
    youngs_modulus : float
        Young's modulus [Pa].
    density : float
        Density [kg/m^3].
    damping_per_length : float
        Viscous damping per length [N s/m^2]. (The source paper writes N s/m; its integral over the length has that.)
    point_masses : tuple of PointMass
        Tip magnets, sensors.

    Raises
    ------
    InputError
        If a dimension or material constant is not positive, or a mass lies beyond the tip.

    See Also
    --------
    paper.natural_modes : its modes.
    paper.reduce_to_one_mode : its oscillator.
    """

    length: float
    width: float
    thickness: float
    youngs_modulus: float
    density: float
    damping_per_length: float
    point_masses: tuple[PointMass, ...] = ()

    def __post_init__(self) -> None:
        for name in ("length", "width", "thickness", "youngs_modulus", "density", "damping_per_length"):
            check_positive(name, getattr(self, name))
        for point in self.point_masses:
            if point.position > self.length:
                raise InputError(
                    f"a point mass must lie on the beam, 0 < position <= {self.length:g} m, got {point.position:g} m. "
                    "Give its distance from the clamp in metres."
                )

    @property
    def bending_stiffness(self) -> float:
        """Young's modulus times second moment of area [N m^2]."""
        return self.youngs_modulus * self.width * self.thickness**3 / 12.0

    @property
    def mass_per_length(self) -> float:
        """Mass per length [kg/m]."""
        return self.density * self.width * self.thickness

    @property
    def tip_stiffness(self) -> float:
        """Static stiffness against a force at the tip, 3 EI / L^3 [N/m]."""
        return 3.0 * self.bending_stiffness / self.length**3

    def with_masses(self, *masses: PointMass) -> CantileverBeam:
        """Return the beam with these point masses in place of those it has."""
        return replace(self, point_masses=masses)


@dataclass(frozen=True)
class OneMode:
    """A beam reduced to one coordinate U, with deflection U times a shape: m U'' + c U' + k U = -P z''.

    The numbers depend on how the shape is scaled: m, c and k with its square, P in proportion. Their ratios do not.

    Attributes
    ----------
    mass : float
        Modal mass m, with all point masses [kg].
    damping : float
        Modal damping c [N s/m].
    stiffness : float
        Modal stiffness k [N/m].
    base_participation : float
        P [kg]: an acceleration z'' of the base acts like the force -P z''; for z = z0 cos(w t) its amplitude is
        P z0 w^2.
    tip : float
        Value of the shape at the tip.

    See Also
    --------
    paper.reduce_to_one_mode : returns it.
    ForcedOscillator : what simulates it.
    """

    mass: float
    damping: float
    stiffness: float
    base_participation: float
    tip: float

    @property
    def frequency(self) -> float:
        """Undamped natural frequency [Hz]."""
        return float(np.sqrt(self.stiffness / self.mass) / (2.0 * np.pi))

    @property
    def damping_ratio(self) -> float:
        """Damping over its critical value."""
        return float(self.damping / (2.0 * np.sqrt(self.stiffness * self.mass)))

    def magnetic_stiffness(self, linear: float, cubic: float) -> tuple[float, float]:
        """Return k_o [N/m] and k_n [N/m^3] of a tip force a0 w + an w^3 of the deflection w at the tip.

        The equation becomes m U'' + c U' + (k - k_o) U - k_n U^3 = 0 with k_o = a0 s^2 and k_n = an s^4, s the shape
        at the tip. A shape that vanishes there, like a half sine, does not feel the magnets at all.

        Parameters
        ----------
        linear : float
            a0 [N/m]; positive pulls the tip away from rest.
        cubic : float
            an [N/m^3].
        """
        return linear * self.tip**2, cubic * self.tip**4


def natural_modes(beam: CantileverBeam, count: int = 3) -> tuple[FloatArray, list[ModeShape]]:
    """Return the lowest natural frequencies and mode shapes of a beam, exact for an Euler-Bernoulli beam.

    Parameters
    ----------
    beam : CantileverBeam
        The beam, with its point masses anywhere.
    count : int, default 3
        How many modes, at least one.

    Returns
    -------
    frequencies : ndarray, shape (count,)
        Natural frequencies [Hz].
    shapes : list of ModeShape
        Functions of the distance from the clamp [m] (and ``derivative=``), scaled to 1 at the tip.

    Raises
    ------
    InputError
        If ``count`` is less than one.

    See Also
    --------
    paper.reduce_to_one_mode : what follows.
    paper.CantileverBeam : what has modes.

    Notes
    -----
    Between point masses the shape is a sum of cos, sin, and two exponentials; the transcendental determinant of the
    conditions that join the pieces is solved to rounding error. Shear, rotary inertia and the stiffness of what is
    glued on are left out.

    References
    ----------
    Blevins R. D. (2016) Formulas for Dynamics, Acoustics and Vibration. Wiley. doi:10.1002/9781119038122

    Examples
    --------
    >>> from pymc_backbone.paper.beam import PAPER_BEAM, natural_modes
    >>> natural_modes(PAPER_BEAM.beam)[0].round(2).tolist()
    [9.23, 57.84, 161.94]
    >>> natural_modes(PAPER_BEAM.beam_with_magnets(2), count=1)[0].round(2).tolist()
    [7.96]
    """
    if int(count) < 1:
        raise InputError(f"`count` must be at least 1, got {count}.")
    merged: dict[float, float] = {}
    for point in beam.point_masses:
        merged[point.position] = merged.get(point.position, 0.0) + point.mass
    positions = np.array(sorted(merged), dtype=float)
    ratios = np.array([merged[position] for position in sorted(merged)], dtype=float) / beam.mass_per_length
    shapes = exact_modes(beam.length, positions, ratios, int(count))
    speed = np.sqrt(beam.bending_stiffness / beam.mass_per_length)
    return np.array([shape.wavenumber**2 * speed for shape in shapes]) / (2.0 * np.pi), shapes


def half_sine(beam: CantileverBeam) -> Shape:
    """Return the shape sin(pi x / L) that the source paper writes down.

    It belongs to a beam on two hinges: it turns at the clamp and stays at rest at the tip, where a cantilever's moves
    most and where the magnets are.

    Parameters
    ----------
    beam : CantileverBeam
        Gives the length L.

    Returns
    -------
    callable
        ``shape(position, derivative=0)``: the shape at positions [m], or a derivative of it [1/m to its order].

    See Also
    --------
    paper.natural_modes : shapes that the beam has.
    paper.reduce_to_one_mode : takes a shape.
    """
    wavenumber = np.pi / beam.length

    def shape(position: FloatArray, derivative: int = 0) -> FloatArray:
        phase = wavenumber * np.asarray(position, dtype=float) + derivative * np.pi / 2.0
        return np.asarray(wavenumber**derivative * np.sin(phase))

    return shape


def reduce_to_one_mode(beam: CantileverBeam, shape: Shape) -> OneMode:
    """Return modal mass, damping, stiffness and base forcing of a beam for one shape, by Galerkin's integrals.

    m = integral of M(x) s^2, c = integral of c_a s^2, k = EI integral of s''^2, P = integral of M(x) s, with M the mass
    per length and all point masses.

    Parameters
    ----------
    beam : CantileverBeam
        The beam.
    shape : callable
        ``shape(x, derivative=0)`` with x [m] an array; second derivatives are used. A mode of `natural_modes`,
        `half_sine`, or any function that is smooth between point masses.

    Returns
    -------
    OneMode
        The reduced system.

    See Also
    --------
    paper.natural_modes : where shapes come from.
    ForcedOscillator : simulates the result.

    Notes
    -----
    The source paper has k = EI integral of s s'''', and a mass without the tip mass. By parts, with its boundary
    condition at the tip, this takes the same amount off k and off w^2 m where s is an exact mode: the frequency is the
    same, the mass is not, and the base forcing then acts on the wrong one. Here both are the energies'.

    Examples
    --------
    >>> from pymc_backbone.paper.beam import PAPER_BEAM, half_sine, reduce_to_one_mode
    >>> sine = reduce_to_one_mode(PAPER_BEAM.beam, half_sine(PAPER_BEAM.beam))
    >>> round(sine.mass, 4), round(sine.damping, 5), round(sine.stiffness, 1)
    (0.0414, 0.07098, 1096.6)
    """
    edges = np.unique([0.0, *(point.position for point in beam.point_masses), beam.length])

    def integrate(power: int, derivative: int) -> float:
        def integrand(x: float) -> float:
            return float(shape(np.array([x]), derivative=derivative)[0] ** power)

        pieces = itertools.pairwise(edges)
        return sum(quad(integrand, low, high, epsabs=0.0, epsrel=1e-9, limit=200)[0] for low, high in pieces)

    points = [(point.mass, float(shape(np.array([point.position]))[0])) for point in beam.point_masses]
    square = integrate(2, 0)
    return OneMode(
        mass=beam.mass_per_length * square + sum(mass * value**2 for mass, value in points),
        damping=beam.damping_per_length * square,
        stiffness=beam.bending_stiffness * integrate(2, 2),
        base_participation=beam.mass_per_length * integrate(1, 0) + sum(mass * value for mass, value in points),
        tip=float(shape(np.array([beam.length]))[0]),
    )


__all__ = ["CantileverBeam", "OneMode", "PointMass", "half_sine", "natural_modes", "reduce_to_one_mode"]
