"""The catalogue of effects, written from the library: a page and pictures for each effect, and a page that compares."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
from freshness import KEEP, digest, write_if_new
from matplotlib.figure import Figure

from pymc_backbone import LIBRARY, Effect, Oscillator, simulate_backbone, simulate_waveform
from pymc_backbone.effects import BASE_EFFECTS

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "pymc_backbone"
MASS, FREQUENCY, DAMPING_RATIO = 1.0, 10.0, 0.005  # kg, Hz, share of critical: what every effect is shown beside
AMPLITUDE, ANGLE = 0.01, 1.0  # m; rad, for effects whose displacement is an angle
BLUE, GREY = "#0072B2", "#8C8C8C"
ACCENTS = re.compile(r"\[(.+?)\]")


def write(folder: Path) -> list[str]:
    """Write all pages and pictures into ``folder``; return the names of the effects."""
    pictures = folder / "pictures"
    pictures.mkdir(parents=True, exist_ok=True)
    key = digest([*PACKAGE.rglob("*.py"), Path(__file__)], ROOT)
    mark = pictures / "drawn_from.txt"
    is_fresh = mark.exists() and (mark.read_text(encoding="utf-8") == key or bool(os.environ.get(KEEP)))
    for effect in LIBRARY.values():
        if not (is_fresh and (pictures / f"{effect.name}_both.svg").exists()):
            draw(effect, pictures)
        write_if_new(folder / f"{effect.name}.md", page(effect))
    write_if_new(folder / "index.md", overview())
    mark.write_text(key, encoding="utf-8")
    return list(LIBRARY)


def title(effect: Effect) -> str:
    """Return the name of an effect as words."""
    words = effect.name.replace("_", " ").capitalize()
    return words.replace("Bouc wen", "Bouc-Wen")


def is_angle(effect: Effect) -> bool:
    """Return whether the displacement is an angle."""
    return any("rad" in parameter.unit for parameter in effect.parameters)


def page(effect: Effect) -> str:
    """Return the page of one effect."""
    signature = effect.signature
    assert signature is not None, f"{effect.name} has no signature"
    force, *definitions = re.split(r"(?<!\\);\s+", effect.latex)
    others = r" + c \dot{x} + k x = 0"
    if effect.name == "linear_stiffness":
        others = r" + c \dot{x} = 0"
    elif effect.name == "viscous_damping":
        others = " + k x = 0"
    lines = [f"({effect.name})=", f"# {title(effect)}", "", f"{effect.summary}", ""]
    lines += ["The force, in the equation of motion:", "", "$$", rf"m \ddot{{x}} + {force}{others}", "$$", ""]
    for definition in definitions:
        lines += ["$$", definition, "$$", ""]
    lines += ["| parameter | symbol | unit | what it is |", "|---|---|---|---|"]
    for parameter in effect.parameters:
        unit = parameter.unit if parameter.unit != "-" else "none"
        lines.append(f"| `{parameter.name}` | ${parameter.latex}$ | {unit} | {parameter.summary} |")
    lines += ["", "## How a decay shows it", ""]
    lines += ["Frequency", f": {signature.frequency}", ""]
    lines += ["Damping", f": {signature.damping}", ""]
    lines += ["Mid-line", f": {signature.offset}", ""]
    lines += ["Found in", f": {signature.found_in}.", ""]
    if effect.variant_of:
        original = ", ".join(f"[{title(LIBRARY[name])}]({name}.md)" for name in effect.variant_of)
        lines += [
            "Variant of",
            f": {original}; `diagnose` looks for it in the place of these, and by itself when it is named",
            "",
        ]
    if effect.with_role("ordinate"):
        lines += ["Not looked for", ": it is drawn where no law explains the records", ""]
    elif effect.only_if_named:
        when = "unless it is named, or nothing else explains the records"
        lines += ["Not looked for", f": {when}: backbones do not tell it from others", ""]
    if signature.resembles:
        links = ", ".join(f"[{title(LIBRARY[name])}]({name}.md)" for name in signature.resembles)
        lines += ["Easily taken for", f": {links}", ""]
    lines += ["::::{grid} 1 2 2 2", ":gutter: 2", ""]
    for what, text in _PICTURES.items():
        alt = f"{text} of {title(effect).lower()}"
        lines += [":::{grid-item}", f"![{alt}](pictures/{effect.name}_{what}.svg)", ":::", ""]
    lines += ["::::", "", _caption(effect), ""]
    lines += ["## Use it", "", "```", f"{_command(effect)}", "```", ""]
    if effect.references:
        lines += ["## References", "", *(f"- {_with_links(reference)}" for reference in effect.references), ""]
    return "\n".join(lines)


_PICTURES = {
    "force": "Force over a cycle",
    "frequency": "Frequency over amplitude",
    "damping": "Damping over amplitude",
    "offset": "Mid-line over amplitude",
}


def _caption(effect: Effect) -> str:
    assert effect.signature is not None
    size = f"{ANGLE:g} rad" if is_angle(effect) else f"{1e3 * AMPLITUDE:g} mm"
    values = effect.signature.typical(MASS, ANGLE if is_angle(effect) else AMPLITUDE, 2.0 * np.pi * FREQUENCY)
    pairs = zip(effect.parameters, values, strict=True)
    chosen = ", ".join(f"`{p.name}` {v:.4g}{'' if p.unit == '-' else ' ' + p.unit}" for p, v in pairs)
    beside = "a linear spring of 10 Hz and 0.5 % of critical damping on 1 kg"
    return (
        f"Simulated with {chosen}, beside {beside}, up to {size}. Blue: with the effect; grey, dashed: without. "
        "The force is drawn over the first cycle. A mid-line of a hundredth comes with heavy damping, not asymmetry."
    )


def _command(effect: Effect) -> str:
    if effect.name in BASE_EFFECTS:
        return "pymc-backbone update my_records/ --mass 1.2 --out result   # every model has it"
    return f"pymc-backbone update my_records/ --mass 1.2 --effect {effect.name} --out result"


def _with_links(reference: str) -> str:
    reference = re.sub(r"doi:(10\.\S+?)(?=[.,]?(\s|$))", r"[doi:\1](https://doi.org/\1)", reference)
    return re.sub(r"arXiv:(\d{4}\.\d{4,5})", r"[arXiv:\1](https://arxiv.org/abs/\1)", reference)


def overview() -> str:
    """Return the page that compares all effects."""
    lines = ["(effect-catalogue)=", "# Catalogue of effects", ""]
    lines += [
        f"The {len(LIBRARY)} physical effects of the library, written from the library itself when this site is built. "
        "Every model has a linear spring and a viscous damper; the others are what `--effect` adds and what "
        "`diagnose` looks for; variants and what one mode does not show only when they are named, as their pages say.",
        "",
        "How to read the pictures: left the frequency, right the damping (logarithmic decrement per cycle), over the "
        "amplitude. Grey and dashed is the linear oscillator without the effect.",
        "",
        "::::{grid} 1 2 2 2",
        ":gutter: 3",
        "",
    ]
    for effect in LIBRARY.values():
        lines += [f":::{{grid-item-card}} {title(effect)}", f":link: {effect.name}", ":link-type: doc", ""]
        lines += [f"![Backbones of {title(effect).lower()}](pictures/{effect.name}_both.svg)", ""]
        lines += [f"{effect.summary}", ":::", ""]
    lines += ["::::", "", "## Which effect does this look like?", ""]
    lines += [
        "What each curve does as the **amplitude rises**. A decay runs the other way: it begins at the right end.",
        "",
        "| effect | frequency | damping | mid-line |",
        "|---|---|---|---|",
    ]
    for effect in LIBRARY.values():
        signature = effect.signature
        assert signature is not None
        cells = " | ".join(_first(words) for words in (signature.frequency, signature.damping, signature.offset))
        lines.append(f"| [{title(effect)}]({effect.name}.md) | {cells} |")
    lines += [
        "",
        "Several effects share a pattern. Telling them apart needs the shape of the curve and, better, the waveform "
        "itself: that is what [naming](../../naming.md) does. For an effect that is not here, see "
        "[My effect is not in the library](../../how-to/own_effect.md).",
        "",
        "```{toctree}",
        ":hidden:",
        "",
        *LIBRARY,
        "```",
        "",
    ]
    return "\n".join(lines)


def _first(words: str) -> str:
    """Return the first clause of a description."""
    trends = ("Rises, then falls",)
    for trend in trends:
        if words.startswith(trend):
            return trend
    return re.split(r"[:;.]|, (?=and |as |whatever)", words)[0]


def draw(effect: Effect, folder: Path) -> None:
    """Draw force, frequency, damping and mid-line of an effect, and the small picture of the overview."""
    size = ANGLE if is_angle(effect) else AMPLITUDE
    omega = 2.0 * np.pi * FREQUENCY
    scale, unit = (1.0, "rad") if is_angle(effect) else (1e3, "mm")
    assert effect.signature is not None
    values = dict(zip(effect.parameter_names, effect.signature.typical(MASS, size, omega), strict=True))
    linear = {"linear_stiffness": MASS * omega**2, "viscous_damping": 2.0 * DAMPING_RATIO * MASS * omega}
    own = () if effect.name in BASE_EFFECTS else effect.name
    with_it, without = Oscillator(MASS, own), Oscillator(MASS)
    levels = size * np.linspace(0.04, 1.0, 97)
    curves = simulate_backbone(with_it, linear | values, levels).values
    bare = simulate_backbone(without, linear, levels).values
    rows = {
        "frequency": (0, "Frequency [Hz]"),
        "damping": (1, "Damping [-]"),
        "offset": (2, "Mid-line / amplitude [-]"),
    }

    def panel(axis, row: int, label: str) -> None:
        axis.plot(scale * levels, bare[row], color=GREY, linestyle="--", linewidth=1.2)
        axis.plot(scale * levels, curves[row], color=BLUE, linewidth=1.8)
        axis.set(xlabel=f"Amplitude [{unit}]", ylabel=label, xlim=(0.0, scale * size))
        both = np.concatenate([curves[row], bare[row]])
        middle = 0.5 * (np.nanmax(both) + np.nanmin(both))
        least = {0: 0.02 * FREQUENCY, 1: 0.04, 2: 0.06}[row]  # a constant looks constant
        half = max(0.5 * float(np.ptp(both[np.isfinite(both)])), 0.5 * least)
        axis.set_ylim(middle - 1.12 * half, middle + 1.12 * half)
        if row == 1:
            axis.set_ylim(bottom=0.0)
        axis.ticklabel_format(useOffset=False)

    for name, (row, label) in rows.items():
        figure, axis = _panel()
        panel(axis, row, label)
        _save(figure, folder / f"{effect.name}_{name}.svg")
    figure = Figure(figsize=(5.0, 1.9), layout="constrained")
    left, right = figure.subplots(1, 2)
    panel(left, 0, "Frequency [Hz]")
    panel(right, 1, "Damping [-]")
    _tidy(figure)
    _save(figure, folder / f"{effect.name}_both.svg")

    figure, axis = _panel()
    x, force = _loop(
        with_it, linear | values, linear if own else {"linear_stiffness": 0.0, "viscous_damping": 0.0}, size
    )
    if effect.name == "linear_stiffness":
        force = values["linear_stiffness"] * x
    elif effect.name == "viscous_damping":
        force = force - linear["linear_stiffness"] * x
    factor, newton = (1.0, "N m") if is_angle(effect) else (1.0, "N")
    axis.plot(scale * x, factor * force, color=BLUE, linewidth=1.8)
    axis.axhline(0.0, color=GREY, linewidth=0.6)
    axis.axvline(0.0, color=GREY, linewidth=0.6)
    axis.set(xlabel=f"Displacement [{unit}]", ylabel=f"Force of the effect [{newton}]")
    _save(figure, folder / f"{effect.name}_force.svg")


def _loop(oscillator, parameters, removed, size):
    """Return displacement and force over the first cycle of a decay, without what is ``removed``."""
    time = np.linspace(0.0, 1.12 / FREQUENCY, 6001)
    x = simulate_waveform(oscillator, parameters, time, size).displacement
    step = time[1] - time[0]
    v, acceleration = (x[2:] - x[:-2]) / (2.0 * step), (x[2:] - 2.0 * x[1:-1] + x[:-2]) / step**2
    force = -MASS * acceleration - removed["viscous_damping"] * v - removed["linear_stiffness"] * x[1:-1]
    turns = np.flatnonzero((v[:-1] < 0.0) != (v[1:] < 0.0))
    end = turns[1] if turns.size > 1 else v.size - 1
    return x[1:-1][2:end], force[2:end]


def _panel():
    figure = Figure(figsize=(3.6, 2.6), layout="constrained")
    axis = figure.subplots()
    _tidy(figure)
    return figure, axis


def _tidy(figure: Figure) -> None:
    for axis in figure.axes:
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(labelsize=8)
        axis.xaxis.label.set_size(9)
        axis.yaxis.label.set_size(9)


def _save(figure: Figure, path: Path) -> None:
    for axis in figure.axes:
        axis.xaxis.label.set_size(9)
        axis.yaxis.label.set_size(9)
    figure.savefig(path, metadata={"Date": None})
