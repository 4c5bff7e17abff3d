"""Free decays computed a second way, for the tests of the simulator: SciPy's DOP853, nothing of the package's own.

Half cycle by half cycle with the sign of the velocity frozen, and smooth piece by smooth piece: every contact, every
onset of slip and every change of sign of a hysteretic state is an event that ends an integration. Sliders are described
by their own position, not by the last turning point as in the package.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

RTOL = 3e-14  # the least that SciPy accepts without a warning is 100 eps
STEPS_PER_RADIAN = 10  # keeps the dense output, on which events are located, as good as the steps


class Spring:
    """A force without memory: ``law(x, v, d, p)``, smooth between the displacements in ``kinks(p)``."""

    def __init__(self, law: Callable[..., float], kinks: Callable[..., tuple[float, ...]] = lambda p: ()) -> None:
        self.law, self.kinks = law, kinks
        self.n_states = 0

    def mass(self, p, x):
        return 0.0

    def start(self, p, x):
        return np.empty(0)

    def enter(self, p, x, d, z):
        # On a kink up to rounding: the side that is being entered.
        self.zone = [d if abs(x - kink) < 1e-11 * self.size else np.sign(x - kink) for kink in self.kinks(p)]

    def force(self, p, x, v, d, z):
        return self.law(x, v, d, p, *self.zone)

    def rate(self, p, x, v, d, z):
        return ()

    def events(self, p, d):
        return [lambda x, v, z, kink=kink: x - kink for kink in self.kinks(p)]

    def turn(self, p, x, z, d):
        return z


class MovingMass(Spring):
    """A mass p[0] x^2 that moves along: what Lagrange's equation holds beside its share of the acceleration."""

    def __init__(self) -> None:
        super().__init__(lambda x, v, d, p: (2.0 * p[0] * x * v) * v - 0.5 * (2.0 * p[0] * x) * v**2)

    def mass(self, p, x):
        return p[0] * x**2


class Slider(Spring):
    """A spring (stiffness p[0]) whose foot is dragged along when its force reaches p[1]; the state is the foot."""

    def __init__(self) -> None:
        self.n_states = 1

    def start(self, p, x):
        return np.array([x - np.sign(x) * min(abs(x), p[1] / p[0])])

    def enter(self, p, x, d, z):
        self.slips = d * p[0] * (x - z[0]) >= p[1] * (1.0 - 1e-11)

    def force(self, p, x, v, d, z):
        return d * p[1] if self.slips else p[0] * (x - z[0])

    def rate(self, p, x, v, d, z):
        return (v if self.slips else 0.0,)

    def events(self, p, d):
        return [lambda x, v, z: 1.0 if self.slips else d * p[0] * (x - z[0]) - p[1]]


class SliderBed(Spring):
    """Iwan's bed by Masing's rule, written with the whole history of turning points."""

    def __init__(self) -> None:
        self.n_states = 0

    @staticmethod
    def virgin(u, p):
        """Return the loading curve as Segalman writes it, with R and phi_max."""
        stiffness, strength, chi = p
        largest = strength * (chi + 2.0) / (stiffness * (chi + 1.0))
        density = strength * (chi + 2.0) / largest ** (chi + 2.0)  # = R
        w = min(abs(u), largest)
        sticking = density * w * (largest ** (chi + 1.0) - w ** (chi + 1.0)) / (chi + 1.0)
        return np.sign(u) * (density * w ** (chi + 2.0) / (chi + 2.0) + sticking)

    def start(self, p, x):
        self.reversal = (x, self.virgin(x, p))
        return np.empty(0)

    def enter(self, p, x, d, z):
        pass

    def force(self, p, x, v, d, z):
        x_r, f_r = self.reversal
        return f_r + 2.0 * self.virgin(0.5 * (x - x_r), p)

    def events(self, p, d):
        largest = p[1] * (p[2] + 2.0) / (p[0] * (p[2] + 1.0))
        return [lambda x, v, z: abs(x - self.reversal[0]) - 2.0 * largest]

    def turn(self, p, x, z, d):
        self.reversal = (x, self.force(p, x, 0.0, d, z))
        return z


class BoucWen(Spring):
    """Wen's equation, in pieces of one sign of the hysteretic displacement."""

    def __init__(self) -> None:
        self.n_states = 1

    def start(self, p, x):
        # Slow loading from rest: dz/dx on the virgin curve.
        _, a, _, beta, gamma, n = p
        run = solve_ivp(
            lambda s, z: a - (beta + gamma) * abs(z) ** n,
            (0.0, abs(x)),
            [0.0],
            "DOP853",
            rtol=RTOL,
            atol=1e-18 * abs(x),
        )
        return np.sign(x) * run.y[:, -1]

    def enter(self, p, x, d, z):
        self.sign = d if abs(z[0]) < 1e-12 * self.size else np.sign(z[0])

    def force(self, p, x, v, d, z):
        return (1.0 - p[2]) * p[0] * z[0]

    def rate(self, p, x, v, d, z):
        _, a, _, beta, gamma, n = p
        # The frozen sign also beyond zero, where a trial step may put z.
        power = self.sign * z[0] if n == 1.0 else abs(z[0]) ** n
        return (a * v - beta * d * v * power * self.sign - gamma * v * power,)

    def events(self, p, d):
        return [lambda x, v, z: z[0]]

    def turn(self, p, x, z, d):
        return z


class Dahl(Spring):
    """Dahl's equation for the force itself, started from its own solution for slow loading."""

    def __init__(self) -> None:
        self.n_states = 1

    def start(self, p, x):
        return np.array([-np.sign(x) * p[1] * np.expm1(-p[0] * abs(x) / p[1])])

    def enter(self, p, x, d, z):
        pass

    def force(self, p, x, v, d, z):
        return z[0]

    def rate(self, p, x, v, d, z):
        return (p[0] * v * (1.0 - d * z[0] / p[1]),)

    def events(self, p, d):
        return []


class MaxwellArm(Dahl):
    """A spring and a damper in series: the state is the place where they meet, which is pulled along."""

    def start(self, p, x):
        return np.array([x])  # loaded slowly, so relaxed

    def force(self, p, x, v, d, z):
        return p[0] * (x - z[0])

    def rate(self, p, x, v, d, z):
        return ((x - z[0]) / p[1],)


def _freeplay(x, v, d, p, low, high):
    return p[0] * (x + p[1]) if low < 0.0 else p[0] * (x - p[1]) if high > 0.0 else 0.0


def _offset_freeplay(x, v, d, p, low, high):
    middle = p[1] * p[2]
    return _freeplay(x - middle, v, d, p, low, high)


def _dead_band(x, v, d, p, *sides):
    """Inside, on an edge or beyond, by the signs of the distances to the four ends of the edges."""
    place = sum(sides)
    if abs(place) != 2.0:
        return p[0] * v if abs(place) == 4.0 else 0.0
    share = (abs(x) / p[1] - 0.98) / 0.04
    return p[0] * v * share**2 * (3.0 - 2.0 * share)


def _one_sided(x, v, d, p, side):
    at_rest = -p[0] * p[1] if p[1] < 0.0 else 0.0
    return (p[0] * (x - p[1]) if side > 0.0 else 0.0) - at_rest


def _damped_stop(x, v, d, p, side):
    """With loss on the way in and less force on the way out, by the sign of the distance to the place of contact."""
    mirror = np.sign(p[0])
    pressed = abs(p[0]) * (mirror * x - p[1]) if mirror * side > 0.0 else 0.0
    return mirror * (pressed + pressed * p[2] * mirror * v + abs(p[0]) * min(p[1], 0.0))


def _hertz(x, v, d, p, side):
    mirror = np.sign(p[0])
    at_rest = abs(p[0]) * (-p[1]) ** 1.5 if p[1] < 0.0 else 0.0
    approach = max(mirror * x - p[1], 0.0) if mirror * side > 0.0 else 0.0
    return mirror * (abs(p[0]) * approach**1.5 - at_rest)


def _power(base, p):
    """Return the ratio of ``base`` to the reference to the exponent, by the logarithm."""
    return np.exp(p[1] * np.log(base / p[2])) if base > 0.0 else 0.0


def _magnets(x, v, d, p):
    assert abs(x) < 0.9 * p[1], "the law is looked at where it is that of magnets"
    near, far = (p[1] / (p[1] - x)) ** p[2], (p[1] / (p[1] + x)) ** p[2]
    return p[0] * (near - far) - 2.0 * p[0] * p[2] / p[1] * x


def _straight_beyond(curve, u):
    last = float(np.clip(u, curve.x[0], curve.x[-1]))
    return float(curve(last) + curve(last, 1) * (u - last))


@cache
def _spring_curve(p):
    odd, even = np.array([*p[1:12], p[0]]), np.array(p[12:24])
    return CubicSpline(np.arange(-12, 13) / 12.0, np.concatenate([even[::-1] - odd[::-1], [0.0], even + odd]))


@cache
def _damper_curves(p):
    nodes = (np.arange(11) / 10.0) ** 2
    even = CubicSpline(np.concatenate([-nodes[:0:-1], nodes]), [*p[20:10:-1], 0.0, *p[11:21]])
    return CubicSpline(nodes, [*p[1:11], p[0]]), even


def tabulated_stiffness(x, v, d, p):
    """SciPy's spline through all nodes, straight beyond the last ones."""
    return _straight_beyond(_spring_curve(tuple(p)), x / p[24])


def tabulated_damping(x, v, d, p):
    """SciPy's splines; what lies before rest in the direction of motion is the first piece, carried on."""
    odd, even = _damper_curves(tuple(p))
    u = max(d * v / p[21], -0.01)
    return d * (float(odd(u)) if u < 0.0 else _straight_beyond(odd, u)) + _straight_beyond(even, d * u)


ORACLES: dict[str, Callable[[], Spring]] = {
    "linear_stiffness": lambda: Spring(lambda x, v, d, p: p[0] * x),
    "viscous_damping": lambda: Spring(lambda x, v, d, p: p[0] * v),
    "quadratic_stiffness": lambda: Spring(lambda x, v, d, p: p[0] * x**2),
    "cubic_stiffness": lambda: Spring(lambda x, v, d, p: p[0] * x**3),
    "quintic_stiffness": lambda: Spring(lambda x, v, d, p: p[0] * x**5),
    "pendulum_stiffness": lambda: Spring(lambda x, v, d, p: p[0] * (np.sin(x) - x)),
    "coulomb_friction": lambda: Spring(lambda x, v, d, p: p[0] * d),
    "quadratic_damping": lambda: Spring(lambda x, v, d, p: p[0] * d * v * v),
    "asymmetric_drag": lambda: Spring(lambda x, v, d, p: p[0] * (1.0 + p[1] * d) * d * v * v),
    "bilinear_damping": lambda: Spring(lambda x, v, d, p: 0.5 * p[0] * (1.0 + d) * v),
    "cubic_damping": lambda: Spring(lambda x, v, d, p: p[0] * v**3),
    "displacement_dependent_damping": lambda: Spring(lambda x, v, d, p: p[0] * x * x * v),
    "bilinear_stiffness": lambda: Spring(lambda x, v, d, p, side: p[0] * x if side > 0.0 else 0.0, lambda p: (0.0,)),
    "freeplay": lambda: Spring(_freeplay, lambda p: (-p[1], p[1])),
    "jenkins": Slider,
    "iwan": SliderBed,
    "bouc_wen": BoucWen,
    "stribeck_friction": lambda: Spring(lambda x, v, d, p: d * (p[0] + p[0] * p[1] / np.exp(d * v / p[2]))),
    "power_damping": lambda: Spring(lambda x, v, d, p: p[0] * v / p[2] * np.hypot(v / p[2], 1e-3) ** (p[1] - 1.0)),
    "power_stiffness": lambda: Spring(lambda x, v, d, p, side: p[0] * side * _power(side * x, p), lambda p: (0.0,)),
    "offset_freeplay": lambda: Spring(_offset_freeplay, lambda p: (p[1] * (p[2] - 1.0), p[1] * (p[2] + 1.0))),
    "one_sided_stiffness": lambda: Spring(_one_sided, lambda p: (p[1],)),
    "damped_stop": lambda: Spring(_damped_stop, lambda p: (np.sign(p[0]) * p[1],)),
    "hertz_contact": lambda: Spring(_hertz, lambda p: (np.sign(p[0]) * p[1],)),
    "magnetic_stiffness": lambda: Spring(_magnets),
    "absolute_displacement_damping": lambda: Spring(lambda x, v, d, p, side: p[0] * side * x * v, lambda p: (0.0,)),
    "power_displacement_damping": lambda: Spring(lambda x, v, d, p: p[0] * v * np.hypot(x / p[2], 1e-2) ** p[1]),
    "dead_band_damping": lambda: Spring(_dead_band, lambda p: (-1.02 * p[1], -0.98 * p[1], 0.98 * p[1], 1.02 * p[1])),
    "mid_stroke_damping": lambda: Spring(lambda x, v, d, p: p[0] * v / np.exp(x**2 / p[1] ** 2)),
    "speed_limited_damping": lambda: Spring(lambda x, v, d, p: p[0] * v * p[1] ** 2 / (p[1] ** 2 + v**2)),
    "geometric_stiffness": lambda: Spring(lambda x, v, d, p: p[0] * x * (1.0 - p[1] / np.hypot(x, p[1]))),
    "structural_damping": lambda: Spring(lambda x, v, d, p, side: p[0] * side * x * d, lambda p: (0.0,)),
    "tabulated_stiffness": lambda: Spring(tabulated_stiffness),
    "tabulated_damping": lambda: Spring(tabulated_damping),
    "nonlinear_inertia": MovingMass,
    "dahl_friction": Dahl,
    "maxwell_element": MaxwellArm,
}


class Decay:
    """A free decay of an oscillator, turning point by turning point.

    Parameters
    ----------
    oscillator
        Mass and names of effects are all that is taken from it.
    parameters : array_like
        Parameter vector.
    """

    def __init__(self, oscillator, parameters) -> None:
        self.mass = oscillator.mass
        self.parts = []
        first = 0
        for effect in oscillator.effects:
            if effect.name not in ORACLES:
                raise AssertionError(
                    f"effect {effect.name!r} has no oracle: write its force a second time in tests/decay_oracles.py"
                )
            size = len(effect.parameters)
            self.parts.append((ORACLES[effect.name](), [float(p) for p in parameters[first : first + size]]))
            first += size
        self.t, self.d = 0.0, -1.0
        self.segments = []

    def release(self, amplitude):
        """Start at rest, slowly loaded from zero."""
        self.t, self.d = 0.0, -np.sign(amplitude)
        self.segments = []
        states = []
        for part, p in self.parts:
            part.size = abs(amplitude)
            states.append(part.start(p, amplitude))
        self.y = np.concatenate([[amplitude, 0.0], *states])
        self.scale = abs(amplitude)
        return self

    def _split(self, y):
        at = 2
        for part, p in self.parts:
            yield part, p, y[at : at + part.n_states]
            at += part.n_states

    def _slope(self, t, y):
        x, v = y[0], y[1]
        total = sum(part.force(p, x, v, self.d, z) for part, p, z in self._split(y))
        rates = [r for part, p, z in self._split(y) for r in part.rate(p, x, v, self.d, z)]
        heavier = self.mass + sum(part.mass(p, x) for part, p in self.parts)
        return np.array([v, -total / heavier, *rates])

    def half_cycle(self):
        """Go on to the next turning point; return (time, displacement), or None where it sticks."""
        for part, p, z in self._split(self.y):
            part.enter(p, self.y[0], self.d, z)
        a = self._slope(self.t, self.y)[1]
        if a * self.d <= 0.0:
            return None
        omega = np.sqrt(abs(a) / self.scale)
        speed = omega * self.scale
        started = False
        for _ in range(20):
            for part, p, z in self._split(self.y):
                part.enter(p, self.y[0], self.d, z)

            def turning(t, y):
                return y[1] * self.d / speed

            turning.terminal, turning.direction = True, -1.0
            events = [turning]
            at = 2
            for part, p in self.parts:
                for event in part.events(p, self.d):

                    def wrapped(t, y, event=event, at=at, n=part.n_states):
                        return event(y[0], y[1], y[at : at + n])

                    # What the piece starts on is not what ends it.
                    value = wrapped(self.t, self.y)
                    after = wrapped(self.t, self.y + 1e-7 * self.scale * np.sign(self._slope(0.0, self.y)))
                    wrapped.terminal = True
                    wrapped.direction = -1.0 if value > 0.0 else 1.0
                    if abs(value) < 1e-9 * max(abs(after), 1e-300) or abs(value) < 1e-13 * self.scale:
                        wrapped.direction = -np.sign(after)
                    events.append(wrapped)
                at += part.n_states
            run = solve_ivp(
                self._slope, (self.t, self.t + 40.0 / omega), self.y, "DOP853", events=events, dense_output=True,
                rtol=RTOL, atol=RTOL * np.concatenate([[self.scale, speed], np.full(self.y.size - 2, self.scale)]),
                max_step=1.0 / (STEPS_PER_RADIAN * omega), first_step=1e-3 / omega if not started else None,
            )  # fmt: skip
            started = True
            self.segments.append((run.t[0], run.t[-1], run.sol))
            self.t, self.y = run.t[-1], run.y[:, -1].copy()
            if run.t_events[0].size:
                break
            assert run.status == 1, "an oracle's half cycle did not end"
        else:
            raise AssertionError("an oracle found too many events in a half cycle")
        at = 2
        for part, p in self.parts:
            z = self.y[at : at + part.n_states]
            self.y[at : at + part.n_states] = part.turn(p, self.y[0], z, self.d)
            at += part.n_states
        self.y[1] = 0.0
        self.d = -self.d
        return self.t, self.y[0]

    def turning_points(self, amplitude, count):
        """Return times and displacements of the release and the next ``count`` turning points."""
        self.release(amplitude)
        points = [(0.0, amplitude)]
        while len(points) <= count:
            point = self.half_cycle()
            if point is None:
                break
            points.append(point)
        return np.array(points).T

    def displacement(self, time):
        """Return the displacement at instants that the turning points run so far enclose."""
        out = np.full(np.shape(time), np.nan)
        for first, last, sol in self.segments:
            inside = (time >= first) & (time <= last)
            if inside.any():
                out[inside] = sol(time[inside])[0]
        return out

    def rates(self, time):
        """Return velocity and acceleration at such instants; the acceleration by differences of the velocity."""
        out = np.full((2, *np.shape(time)), np.nan)
        for first, last, sol in self.segments:
            inside = (time >= first) & (time <= last)
            if inside.any():
                at, step = time[inside], 1e-3 * (last - first)
                # five points; the polynomial of a segment also holds a little way beyond its ends
                v = [sol(at + k * step)[1] for k in (-2, -1, 0, 1, 2)]
                out[0, inside] = v[2]
                out[1, inside] = (v[0] - 8.0 * v[1] + 8.0 * v[3] - v[4]) / (12.0 * step)
        return out


def cycles(times, x):
    """Return amplitude, frequency, decrement and offset of the cycles between positive peaks, shape (4, n)."""
    first = 0 if x[0] > x[1] else 1
    p0, q, p1 = x[first:-2:2], x[first + 1 : -1 : 2], x[first + 2 :: 2]
    t0, t1 = times[first:-2:2], times[first + 2 :: 2]
    n = len(p1)
    p0, q, t0 = p0[:n], q[:n], t0[:n]
    amplitude = (p0 + p1 - 2 * q) / 4
    return np.array([amplitude, 1 / (t1 - t0), 2 * np.log((p0 - q) / (p1 - q)), ((p0 + p1) / 2 + q) / 2 / amplitude])


def cycle_at(decay: Decay, level: float) -> np.ndarray:
    """Return frequency, decrement and offset of the one cycle of this amplitude (no internal states), by secants.

    The integrator rounds: where secants no longer come nearer and what is left is rounding, the nearest cycle counts.
    """

    def quantities(start):
        return cycles(*decay.turning_points(start, 2))[:, 0]

    before, start = level, 1.01 * level
    error = quantities(before)[0] - level
    for _ in range(30):
        found = quantities(start)
        new_error = found[0] - level
        if abs(new_error) < 1e-13 * level or (abs(error) < 1e-11 * level and abs(new_error) >= abs(error)):
            return found[1:]
        step = new_error * (start - before) / (new_error - error)
        before, error, start = start, new_error, start - step
    raise AssertionError(f"the oracle found no cycle of amplitude {level}")
