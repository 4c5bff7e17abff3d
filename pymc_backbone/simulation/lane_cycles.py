"""A cycle of many parameter vectors of one smooth oscillator, side by side in lanes.

The motion is followed in the phase plane: displacement ``r cos(angle)``, velocity ``-r omega sin(angle)``. With the
angle as the independent variable,

    dr/dangle = -r sin (r cos - g) / (r sin^2 + g cos),    dt/dangle = r / (r sin^2 + g cos) / omega,

where ``g = force / (mass omega^2)``. Turning points then lie on the grid of the steps, whatever the oscillator: a half
cycle is as many equal steps in all lanes, the sign of the velocity is constant in it, and nothing has to be looked
for. With ``omega`` near the cycle's own frequency the radius hardly changes, so that few steps of order 8 do. Where the
denominator, the pace of the angle, is not positive, the motion does not turn as it should: the lane has failed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from .._common.checks import FloatArray, IntArray
from ..effects import Effect
from .forces import ADDS_MASS, CODE, P_FIRST, ROW
from .lane_stages import (
    AMPLITUDE,
    AMPLITUDE_BEFORE,
    ERROR,
    FAILED,
    FORCE,
    LANES,
    NODES,
    OMEGA,
    PACE,
    PARAMETERS,
    PEAK,
    RADIUS,
    SCALE,
    SLOPES,
    STAGE,
    STAGES,
    START,
    START_BEFORE,
    TIME,
    TROUGH,
    WEIGHTS,
    WORST,
    V,
    X,
    to_end,
    to_stage,
)
from .memory import DAMPING, N_EFFECTS, STIFFNESS, TABLE
from .pointers import Floats, Integers, address, shifted
from .switches import library_effects, plain


class Block(NamedTuple):
    """What all lanes share: mass, places of the parameters, effects, steps of a half cycle, the array they work in."""

    mass: float
    stiffness: int
    damping: int
    table: Integers
    n_effects: int
    steps: int
    angles: Floats
    w: Floats


def is_smooth(effect: Effect) -> bool:
    """Return whether an effect's force is smooth inside a half cycle and remembers nothing, by what it declares.

    What has more parameters than its strength may be as sharp as they make it: equal steps of the angle would have to
    be short for its sake, and the estimate of their error was checked against forces of one shape only.
    """
    return effect.regime is None and not effect.has_memory and effect.n_states == 0 and len(effect.parameters) == 1


def _switch() -> Any:
    """Return one compiled ``f(code, first, direction, w)`` that adds a library effect's force in all lanes.

    The switch stands outside of the lanes, so that each loop is one effect's force and nothing else, and all models
    share one compiled kernel. The text holds indices only.
    """
    lines = ["def add_force(code, first, direction, w):"]
    names: dict[str, Any] = {"LANES": LANES, "X": X, "V": V, "FORCE": FORCE, "PARAMETERS": PARAMETERS}
    for code, effect in library_effects():
        if not is_smooth(effect):
            continue
        force: Any = effect.force
        names[f"f{code}"] = plain(force.py_func)
        own = "".join(f"w[PARAMETERS + (first + {j}) * LANES + i], " for j in range(len(effect.parameters)))
        lines += [f"    if code == {code}:", "        for i in range(LANES):"]
        lines += [
            f"            w[FORCE + i] += f{code}(w[X + i], w[V + i], direction, (0.0,), ({own}))",
            "        return",
        ]
    exec("\n".join(lines), names)  # only the package's own functions, by number
    return plain(names["add_force"])


def _mass_switch() -> Any:
    """Return one compiled ``f(code, first, mass, w)`` that takes from the force what a library effect's mass takes."""
    lines = ["def share_force(code, first, mass, w):"]
    names: dict[str, Any] = {"LANES": LANES, "X": X, "FORCE": FORCE, "PARAMETERS": PARAMETERS}
    for code, effect in library_effects():
        if effect.added_mass is None or not is_smooth(effect):
            continue
        function: Any = effect.added_mass
        names[f"f{code}"] = plain(function.py_func)
        own = "".join(f"w[PARAMETERS + (first + {j}) * LANES + i], " for j in range(len(effect.parameters)))
        lines += [f"    if code == {code}:", "        for i in range(LANES):"]
        lines += [f"            w[FORCE + i] *= mass / (mass + f{code}(w[X + i], ({own})))", "        return"]
    lines.append("    return")
    exec("\n".join(lines), names)  # only the package's own functions, by number
    return plain(names["share_force"])


_add_force: Callable[..., None] = _switch()
_share_force: Callable[..., None] = _mass_switch()


@plain
def _add_forces(block: Block, direction: float) -> None:
    """Add the forces of all effects but spring and damper, less where mass is added."""
    for effect in range(block.n_effects):
        row = shifted(block.table, ROW * effect)
        _add_force(row[CODE], row[P_FIRST], direction, block.w)
    for effect in range(block.n_effects):
        row = shifted(block.table, ROW * effect)
        if row[ADDS_MASS] != 0:  # one of them at most, see `can_take_lanes`
            _share_force(row[CODE], row[P_FIRST], block.mass, block.w)


@plain
def _force(block: Block, direction: float) -> None:
    """Write the total force of each lane at its displacement and velocity."""
    w = block.w
    k, c = PARAMETERS + block.stiffness * LANES, PARAMETERS + block.damping * LANES
    for i in range(LANES):
        w[FORCE + i] = w[k + i] * w[X + i] + w[c + i] * w[V + i]
    _add_forces(block, direction)


@plain
def _half_cycle(block: Block, sign: float) -> None:
    """Advance the radius by half a turn; ``sign`` is that of the displacement it starts from."""
    w = block.w
    stiffness, damping = PARAMETERS + block.stiffness * LANES, PARAMETERS + block.damping * LANES
    h = math.pi / block.steps
    for step in range(block.steps):
        for stage in range(STAGES):
            cosine = sign * block.angles[2 * (STAGES * step + stage)]
            sine = sign * block.angles[2 * (STAGES * step + stage) + 1]
            to_stage(stage, h, cosine, sine, stiffness, damping, w)
            _add_forces(block, -sign)
            weight = h * WEIGHTS[stage]
            slope = SLOPES + stage * LANES
            for i in range(LANES):
                r = w[STAGE + i]
                g = w[FORCE + i] * w[SCALE + i]
                pace = r * sine * sine + g * cosine
                inverse = 1.0 / pace
                w[PACE + i] = min(w[PACE + i], pace)
                w[slope + i] = -r * sine * (r * cosine - g) * inverse
                w[TIME + i] += weight * r * inverse
        to_end(h, w)


@plain
def run_cycle(block: Block) -> None:
    """Run a cycle of each lane from its starting peak."""
    w = block.w
    for i in range(LANES):
        w[RADIUS + i] = w[START + i]
        w[TIME + i] = 0.0
        w[ERROR + i] = 0.0
        w[PACE + i] = 1e300
    _half_cycle(block, 1.0)
    for i in range(LANES):
        w[TROUGH + i] = -w[RADIUS + i]
    _half_cycle(block, -1.0)
    for i in range(LANES):
        w[TIME + i] /= w[OMEGA + i]
        w[PEAK + i] = w[RADIUS + i]
        w[AMPLITUDE + i] = 0.25 * (w[START + i] + w[PEAK + i] - 2.0 * w[TROUGH + i])
        turns = w[PACE + i] > 0.0 and w[TROUGH + i] < 0.0 and w[PEAK + i] > 0.0
        # comparisons that fail where a number is nan
        if not (turns and w[TIME + i] > 0.0 and w[AMPLITUDE + i] < 1e300 and w[ERROR + i] < 1.0):
            w[FAILED + i] = 1.0


@plain
def take_angle(block: Block) -> None:
    """Let the angle turn at the pace of the cycle that was run."""
    w = block.w
    for i in range(LANES):
        omega = 2.0 * math.pi / w[TIME + i]
        w[OMEGA + i] = omega
        w[SCALE + i] = 1.0 / (block.mass * omega * omega)


@plain
def begin(block: Block, level: float) -> None:
    """Start each lane at a level, with the angle at the pace of the spring between there and the other side."""
    w = block.w
    for i in range(LANES):
        w[X + i] = level
        w[V + i] = 0.0
        w[START + i] = level
        w[FAILED + i] = 0.0
        w[WORST + i] = 0.0
        w[START_BEFORE + i] = 0.0
        w[AMPLITUDE_BEFORE + i] = 0.0
    _force(block, -1.0)
    for i in range(LANES):
        w[SCALE + i] = w[FORCE + i]
        w[X + i] = -level
    _force(block, 1.0)
    for i in range(LANES):
        squared = (w[SCALE + i] - w[FORCE + i]) / (2.0 * block.mass * level)
        if not squared > 0.0:
            w[FAILED + i] = 1.0
            squared = 1.0
        w[OMEGA + i] = math.sqrt(squared)
        w[SCALE + i] = 1.0 / (block.mass * squared)


@plain
def load(block: Block, parameters: FloatArray, order: IntArray, first: int) -> None:
    """Give each lane its parameters; lanes behind the last get those of the last."""
    for i in range(LANES):
        row = order[min(first + i, order.size - 1)]
        for j in range(parameters.shape[1]):
            block.w[PARAMETERS + j * LANES + i] = parameters[row, j]


@plain
def turn(angles: FloatArray, steps: int) -> None:
    """Write cosine and sine of the angle at each stage of each step of half a turn."""
    for step in range(steps):
        for stage in range(STAGES):
            angle = math.pi * (step + NODES[stage]) / steps
            angles[2 * (STAGES * step + stage)] = math.cos(angle)
            angles[2 * (STAGES * step + stage) + 1] = math.sin(angle)


@plain
def describe_block(integers: IntArray, mass: float, steps: int, angles: FloatArray, w: FloatArray) -> Block:
    """Return a block of the oscillator that is described."""
    return Block(
        mass, integers[STIFFNESS], integers[DAMPING], shifted(address(integers), TABLE), integers[N_EFFECTS], steps,
        address(angles), address(w),
    )  # fmt: skip
