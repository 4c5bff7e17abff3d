"""A model with a tabulated spring and damper: which of its coordinates are curves, and how smooth these are.

Four parts: conservative and damping force, each odd and even. A part's roughness is the integral of its squared second
derivative over its range, both in units of the scale of the records. What no roughness sees is settled here: the line
in the odd parts belongs to each specimen's own stiffness and damping.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..._common.checks import FloatArray, IntArray
from ...effects import LIBRARY
from ...effects.tabulated_damping import NODES as SPEEDS
from ...effects.tabulated_stiffness import NODES as DISPLACEMENTS
from ...oscillator import Oscillator
from ..fitting.batch import Batch
from ..fitting.layout import Layout, make_layout
from ..fitting.scatter import SCATTER

STIFFNESS, DAMPING = "tabulated_stiffness", "tabulated_damping"
PARTS = ((STIFFNESS, "odd"), (STIFFNESS, "even"), (DAMPING, "odd"), (DAMPING, "even"))
NODES = {STIFFNESS: DISPLACEMENTS, DAMPING: SPEEDS}
_LOOSE = {STIFFNESS: 1.0, DAMPING: 1e3}
_FINE = 400  # points from which a line through a part is taken


@dataclass(frozen=True, eq=False)
class Part:
    """One part of a tabulated force.

    Attributes
    ----------
    effect, side : str
        Which.
    places : (n,) array of int
        Its coordinates in the layout, by node.
    roughness : (n, n) array
        Integral of the squared second derivative, for node forces in units of the scale, of the curve without its line.
    rank : int
        Directions that it sees.
    """

    effect: str
    side: str
    places: IntArray
    roughness: FloatArray
    rank: int


@dataclass(frozen=True, eq=False)
class Tabulated:
    """The layout of a model with curves.

    Attributes
    ----------
    layout : Layout
        All coordinates.
    parts : tuple of Part
        In the order of `PARTS`.
    scale : float
        Force at the typical amplitude [N].
    reach : float
        Amplitude over which no straight line is left in the odd conservative part [m or rad].
    has_even : bool
        Whether the even parts are free. What they do is a second harmonic and an offset; where neither is in the
        records they are held at zero, for nothing measures them.
    """

    layout: Layout
    parts: tuple[Part, ...]
    scale: float
    reach: float
    has_even: bool = True

    @cached_property
    def named(self) -> IntArray:
        """Coordinates that are no curve."""
        curves = np.concatenate([part.places for part in self.parts])
        return np.setdiff1d(np.arange(self.layout.free.size), curves)

    def ranges(self) -> tuple[float, float]:
        """Return displacement and speed at the last nodes."""
        held = self.layout.held
        return held[f"{STIFFNESS}_range"], held[f"{DAMPING}_range"]

    def forces(self, effect: str, at: FloatArray) -> FloatArray:
        """Return the matrix (n, q) that takes the shared coordinates to forces at displacements or speeds (n,)."""
        law = LIBRARY[effect]
        p = np.zeros(len(law.parameters))
        p[-1] = self.layout.held[f"{effect}_range"]
        out, rows = np.empty(2 + p.size), np.zeros((at.size, self.layout.free.size))
        places = [self.layout.names.index(name) for name in law.parameter_names[:-1]]
        assert law.gradient is not None
        for row, value in zip(rows, at, strict=True):
            law.gradient(float(value), float(value), 1.0 if value >= 0.0 else -1.0, np.zeros(0), p, out)
            row[places] = out[2 : 1 + p.size]
        return rows

    def lines(self) -> FloatArray:
        """Return two rows (2, q) that are zero where no line is left in the odd parts."""
        q = self.layout.free.size
        lines = np.zeros((2, q))
        for row, (effect, reach) in zip(lines, ((STIFFNESS, self.reach), (DAMPING, self.ranges()[1])), strict=True):
            at = reach * (np.arange(_FINE) + 0.5) / _FINE
            row[:] = at @ self.forces(effect, at)
            odd = next(part for part in self.parts if (part.effect, part.side) == (effect, "odd"))
            row[np.setdiff1d(np.arange(q), odd.places)] = 0.0
        return lines

    def free_basis(self) -> tuple[FloatArray, dict[str, slice]]:
        """Return the directions (q, m) in which the shared coordinates are free, and which of them are of a curve.

        What is named comes first; then each curve, without a line in its odd part, and without the even one where that
        is held.
        """
        q = self.layout.free.size
        blocks, own, first = [np.eye(q)[:, self.named]], {}, int(self.named.size)
        for effect, line in zip((STIFFNESS, DAMPING), self.lines(), strict=True):
            sides = ("odd", "even") if self.has_even else ("odd",)
            places = np.concatenate(
                [part.places for part in self.parts if part.effect == effect and part.side in sides]
            )
            frame = np.zeros((q, places.size - 1))
            frame[places] = np.linalg.svd(line[None, places] / np.linalg.norm(line))[2][1:].T
            blocks.append(frame)
            own[effect] = slice(first, first + places.size - 1)
            first += places.size - 1
        return np.hstack(blocks), own

    def places(self, effect: str) -> IntArray:
        """Return the coordinates of a curve: the odd part by node, then the even one."""
        return np.concatenate([part.places for part in self.parts if part.effect == effect])

    @staticmethod
    def loose(part: Part) -> float:
        """Return the precision of each node force of a part that no roughness sees, in units of the scale."""
        return _LOOSE[part.effect] / part.places.size


def tabulate(
    oscillator: Oscillator,
    batch: Batch,
    lowest: float,
    is_sharp: bool = False,
    scatter: float = SCATTER,
    has_even: bool = True,
) -> Tabulated:
    """Return the model with both curves added.

    Parameters
    ----------
    oscillator : Oscillator
        The model.
    batch : Batch
        The data.
    lowest : float
        The amplitude over which no line is left in the odd conservative part [m or rad].
    is_sharp : bool
        Whether the damping force may bend close to rest much faster than at speed, as friction does.
    scatter : float
        How much the sizes of effects and curves differ between specimens, relative to their value.
    has_even : bool
        Whether the even parts are free.
    """
    model = oscillator
    for name in (STIFFNESS, DAMPING):
        if name not in {effect.name for effect in model.effects}:
            model = model + name
    layout = make_layout(model, batch.amplitude, batch.angular_frequency, scatter, is_relaxed=batch.is_relaxed)
    parts = tuple(_part(layout, *part, is_sharp and part == (DAMPING, "odd")) for part in PARTS)
    scale = oscillator.mass * batch.angular_frequency**2 * batch.amplitude
    return Tabulated(layout, parts, scale, lowest, has_even)


def _part(layout: Layout, effect: str, side: str, is_sharp: bool) -> Part:
    """Return one part with its roughness; of a sharp one over the places at which nodes are equally far apart."""
    law = LIBRARY[effect]
    names = sorted(
        (name for name in law.parameter_names if f"_{side}_" in name), key=lambda name: int(name.rpartition("_")[2])
    )
    nodes = NODES[effect]
    inner = np.eye(nodes.size)[:, -len(names) :]
    equal = np.arange(nodes.size, dtype=np.float64) / (nodes.size - 1)
    bends = _bends(equal if is_sharp else nodes, side)
    if is_sharp:  # how it begins is as free as how it bends, and no freer
        bends = np.vstack([bends, (np.eye(nodes.size)[1] - np.eye(nodes.size)[0]) / equal[1]])
    roughness = _without_line(bends @ inner, nodes @ inner, side)
    rank = int(np.linalg.matrix_rank(roughness, tol=1e-9 * float(np.trace(roughness)), hermitian=True))
    return Part(effect, side, np.array([layout.names.index(name) for name in names]), roughness, rank)


def _bends(places: FloatArray, side: str) -> FloatArray:
    """Return the matrix from values at all places to second derivatives, each times the root of its share of the range.

    That the curve goes on beyond zero as an even one is a bend there; as an odd one it is none.
    """
    count, step = places.size, np.diff(places)
    rows = np.zeros((count - 1, count))
    for i in range(1, count - 1):
        a, b = 1.0 / step[i - 1], 1.0 / step[i]
        share = 0.5 * (step[i - 1] + step[i])
        rows[i, i - 1 : i + 2] = np.array([a, -a - b, b]) / np.sqrt(share)
    if side == "even":
        share = 0.5 * step[0]
        rows[0, :2] = np.array([-1.0, 1.0]) / step[0] / np.sqrt(share)
    return rows


def _without_line(bends: FloatArray, line: FloatArray, side: str) -> FloatArray:
    """Return the roughness of a part; of an odd one without its line, which is the specimens' own."""
    roughness: FloatArray = bends.T @ bends
    if side == "odd":
        rough = roughness @ line
        seen = float(line @ rough)
        if seen > 1e-9 * float(np.trace(roughness)):
            roughness = roughness - np.outer(rough, rough) / seen
    return roughness
