"""The beam of the source paper: its published numbers; its modes and the reduction to one are imported along.

Reference: Pandey, Haddad Khodaparast, Friswell, Chatterjee, Madinei, Deighan (2024), arXiv:2410.11902, section 4. What
the published numbers imply and where they contradict each other is worked out in ``docs/beam.md``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from .._common.checks import FloatArray
from ..oscillator import Oscillator
from .galerkin import CantileverBeam, OneMode, PointMass, half_sine, natural_modes, reduce_to_one_mode


@dataclass(frozen=True)
class BeamExperiment:
    """What the source paper publishes of its experiment, as published.

    Attributes
    ----------
    beam : CantileverBeam
        Dimensions and material, no masses.
    magnet_diameter, magnet_thickness, magnet_density : float
        Of one permanent magnet, a disc [m, m, kg/m^3].
    sensor_position : float
        Of the accelerometer on the beam [m]; its mass is not published.
    mass, damping : float
        Of the reduced model [kg, N s/m].
    stiffness : tuple of float
        k_m - k_o of the nine samples [N/m].
    softening : tuple of float
        k_n of the nine samples [N/m^3]: the restoring force is (k_m - k_o) x - k_n x^3.
    release_amplitude : float
        Initial displacement of the simulated decays [m].
    finite_element_frequencies, analytical_frequencies : tuple of float
        First three natural frequencies [Hz].
    measured_bounds, sampled_bounds : dict of str to (float, float)
        Bounds of the Uniform fitted to the frequencies at the low, mid and high amplitude [Hz]. The amplitudes are not
        published.
    posterior : dict of str to (mean, standard deviation, low, high)
        With the 95 % interval, of ``stiffness`` [N/m] and ``softening`` [N/m^3].
    acceptance_rate, r_hat : float
        Of its 20 000 samples.

    See Also
    --------
    paper.PAPER_BEAM : the published one.
    paper.CantileverBeam : any beam.
    """

    beam: CantileverBeam
    magnet_diameter: float
    magnet_thickness: float
    magnet_density: float
    sensor_position: float
    mass: float
    damping: float
    stiffness: tuple[float, ...]
    softening: tuple[float, ...]
    release_amplitude: float
    finite_element_frequencies: tuple[float, ...]
    analytical_frequencies: tuple[float, ...]
    acceptance_rate: float
    r_hat: float
    measured_bounds: dict[str, tuple[float, float]] = field(hash=False)
    sampled_bounds: dict[str, tuple[float, float]] = field(hash=False)
    posterior: dict[str, tuple[float, float, float, float]] = field(hash=False)

    @property
    def magnet_mass(self) -> float:
        """Mass of one magnet [kg]."""
        return self.magnet_density * np.pi / 4.0 * self.magnet_diameter**2 * self.magnet_thickness

    def beam_with_magnets(self, magnets: int, sensor_mass: float = 0.0) -> CantileverBeam:
        """Return the beam with so many magnets at its tip, and a sensor [kg] at its middle."""
        points = [PointMass(self.magnet_mass, self.beam.length)] * magnets
        if sensor_mass:
            points.append(PointMass(sensor_mass, self.sensor_position))
        return self.beam.with_masses(*points)

    @property
    def oscillator(self) -> Oscillator:
        """The reduced model without force: m x'' + c x' + (k_m - k_o) x - k_n x^3 = 0."""
        return Oscillator(self.mass, "cubic_stiffness")

    @property
    def population(self) -> FloatArray:
        """Parameter vectors of the nine samples for `oscillator`, shape (9, 3)."""
        rows: Iterable[dict[str, float]] = (
            {"linear_stiffness": stiffness, "viscous_damping": self.damping, "cubic_stiffness": -softening}
            for stiffness, softening in zip(self.stiffness, self.softening, strict=True)
        )
        return np.array([self.oscillator.pack(row) for row in rows])

    @property
    def escape_amplitudes(self) -> FloatArray:
        """Displacement sqrt((k_m - k_o) / k_n) at which each sample has no restoring force left [m], shape (9,)."""
        amplitudes: FloatArray = np.sqrt(np.array(self.stiffness) / np.array(self.softening))
        return amplitudes


PAPER_BEAM = BeamExperiment(
    beam=CantileverBeam(0.312, 0.030, 0.0011, youngs_modulus=205.5e9, density=8040.0, damping_per_length=0.455),
    magnet_diameter=0.020,
    magnet_thickness=0.0015,
    magnet_density=7500.0,
    sensor_position=0.156,
    mass=0.03842,
    damping=0.07098,
    stiffness=(82.59, 79.00, 71.58, 67.28, 62.91, 78.34, 90.35, 95.33, 97.87),
    softening=(9.16e9, 16.30e9, 25.60e9, 38.10e9, 49.30e9, 15.86e9, 5.72e9, 0.75e9, 0.05e9),
    release_amplitude=1e-5,
    finite_element_frequencies=(8.53, 54.09, 154.17),
    analytical_frequencies=(8.51, 53.37, 149.02),
    acceptance_rate=0.45,
    r_hat=1.0004,
    measured_bounds={"low": (6.398, 8.040), "mid": (6.450, 8.051), "high": (6.454, 8.064)},
    sampled_bounds={"low": (6.405, 8.028), "mid": (6.452, 8.051), "high": (6.481, 8.078)},
    posterior={"stiffness": (80.5, 10.1, 63.7, 96.9), "softening": (25e9, 143.7e9, 1.3e9, 48e9)},
)
"""The experiment of the source paper."""


__all__ = [
    "PAPER_BEAM",
    "BeamExperiment",
    "CantileverBeam",
    "OneMode",
    "PointMass",
    "half_sine",
    "natural_modes",
    "reduce_to_one_mode",
]
