"""Text from files made safe and short for messages, and sorted as people sort it."""

from __future__ import annotations

import re
from collections.abc import Sequence

_PEOPLE = {
    "bouc-wen": "Bouc-Wen", "coulomb": "Coulomb", "dahl": "Dahl", "hertz": "Hertz", "hertzian": "Hertzian",
    "iwan": "Iwan", "jenkins": "Jenkins", "maxwell": "Maxwell", "stribeck": "Stribeck",
}  # fmt: skip
"""Names of people in the names of effects and parameters."""
_HYPHENATED = ("bouc-wen", "displacement-dependent", "one-sided")
"""Words of such names that belong together."""

_MICRO, _NANO = "\N{GREEK SMALL LETTER MU}", "n"
_SPELLED = {_MICRO: "micrometres", _NANO: "nanometres"}
_NUMBERED = re.compile(r"\([^)]*\)|[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_PER_SECOND = {"m": "", "m/s": " per second"}
_LINEAR = re.compile(r"\b(kg|N|m)\b")
_TURNED = {"kg": "kg m^2", "N": "N m", "m": "rad"}
_BRACKETS = re.compile(r"\[([^\]]*)\]")
_EITHER = "; "


def printable(text: str) -> str:
    """Return text on one line with unprintable characters escaped."""
    return "".join(char if char.isprintable() else ascii(char)[1:-1] for char in text)


def shorten(text: str, limit: int = 40) -> str:
    """Return text of at most ``limit`` characters for a message."""
    return text if len(text) <= limit else text[: limit - 3] + "..."


def in_words(name: str) -> str:
    """Return the name of an effect, a parameter or a quantity as people write it, in the middle of a sentence.

    What is typed, such as an option's value or a key of a file, keeps its underscores.

    Examples
    --------
    >>> in_words("coulomb_friction"), in_words("bouc_wen_stiffness"), in_words("one_sided_stiffness")
    ('Coulomb friction', 'Bouc-Wen stiffness', 'one-sided stiffness')
    """
    for joined in _HYPHENATED:
        name = name.replace(joined.replace("-", "_"), joined)
    return " ".join(_PEOPLE.get(word, word) for word in name.split("_"))


def prefix_of(largest: float) -> tuple[float, str]:
    """Return the factor and the prefix of the metre that bring a length into 1 to 1000.

    Examples
    --------
    >>> prefix_of(0.012), prefix_of(1.7)
    ((1000.0, 'm'), (1.0, ''))
    """
    for scale, prefix in ((1.0, ""), (1e3, "m"), (1e6, _MICRO)):
        if largest * scale >= 1.0:
            return scale, prefix
    return 1e9, _NANO


def of_size(values: Sequence[float], unit: str) -> tuple[list[str], str]:
    """Return lengths or speeds as people write them, in the unit that suits the largest; others as they are.

    In ASCII, because a terminal may know no more.

    Examples
    --------
    >>> of_size([2.27e-6, 1.2e-4], "m"), of_size([0.0123], "m/s"), of_size([0.0123], "rad")
    ((['2.27', '120'], 'micrometres'), (['12.3'], 'mm/s'), (['0.0123'], 'rad'))
    """
    largest = max(map(abs, values), default=0.0)
    scale, name = 1.0, unit
    if unit in _PER_SECOND and 0.0 < largest < float("inf"):
        scale, prefix = prefix_of(largest)
        name = f"{_SPELLED[prefix]}{_PER_SECOND[unit]}" if prefix in _SPELLED else f"{prefix}{unit}"
    return [f"{value * scale:.3g}" for value in values], name


def span(low: float, high: float, unit: str) -> str:
    """Return a range of amplitudes in words.

    Examples
    --------
    >>> span(2.27e-6, 1.2e-4, "m"), span(0.1, 0.5, "rad")
    ('2.27 to 120 micrometres', '0.1 to 0.5 rad')
    """
    (first, last), name = of_size((low, high), unit)
    return f"{first} to {last} {name}"


def amplitude(value: float, unit: str) -> str:
    """Return one amplitude in words.

    Examples
    --------
    >>> amplitude(1.2e-4, "m"), amplitude(1.7, "m")
    ('120 micrometres', '1.7 m')
    """
    (number,), name = of_size((value,), unit)
    return f"{number} {name}"


def unit_of(unit: str, amplitude_unit: str) -> str:
    """Return the unit of a force's parameter as it is for a rotation, where the amplitude is an angle.

    Examples
    --------
    >>> unit_of("N s/m^2", "m"), unit_of("N s/m^2", "rad"), unit_of("N m/rad", "rad"), unit_of("kg/m^2", "rad")
    ('N s/m^2', 'N m s/rad^2', 'N m/rad', 'kg m^2/rad^2')
    """
    if amplitude_unit != "rad" or "rad" in unit:
        return unit
    return _LINEAR.sub(lambda found: _TURNED[found.group()], unit)


def equation_of(equation: str, amplitude_unit: str) -> str:
    """Return an equation of motion, its symbols explained line by line, with the units of the motion at hand.

    Examples
    --------
    >>> equation_of("m: mass = 2 [kg; kg m^2 for a rotation]", "rad"), equation_of("k: stiffness [N/m]", "rad")
    ('m: mass = 2 [kg m^2]', 'k: stiffness [N m/rad]')
    """
    # of the mass both units are said, that of a straight motion first
    return _BRACKETS.sub(lambda found: f"[{unit_of(found[1].split(_EITHER)[0], amplitude_unit)}]", equation)


def with_error(value: float, error: float) -> str:
    """Return a value with its standard error, to the digits that the error leaves.

    Examples
    --------
    >>> with_error(0.00782303, 0.012), with_error(-1234.56, 0.5), with_error(0.1234567, 0.0)
    ('0.008 +- 0.012', '-1234.56 +- 0.5', '0.123457 +- 0')
    """
    if 0.0 < error < float("inf"):
        value = round(value, 1 - int(f"{error:.1e}".partition("e")[2]))
    return f"{value:.6g} +- {error:.2g}"


def per_cent(share: float) -> str:
    """Return a share with two digits that mean something, however small it is.

    Examples
    --------
    >>> per_cent(0.012), per_cent(4.2e-6), per_cent(1.003)
    ('1.2 %', '0.00042 %', '100 %')
    """
    value = 100.0 * share
    return f"{value:.0f} %" if abs(value) >= 99.5 else f"{value:.2g} %"


def capitalised(text: str) -> str:
    """Return text with a capital first letter, the others as they are.

    Examples
    --------
    >>> capitalised("quadratic damping + Coulomb friction")
    'Quadratic damping + Coulomb friction'
    """
    return text[:1].upper() + text[1:]


def in_a_sentence(text: str) -> str:
    """Return text that began a sentence as it stands inside of one: names of people keep their capital.

    Examples
    --------
    >>> in_a_sentence("Dry friction"), in_a_sentence("Bouc-Wen hysteresis")
    ('dry friction', 'Bouc-Wen hysteresis')
    """
    first = text.split(" ", 1)[0]
    return text if first in _PEOPLE.values() else text[:1].lower() + text[1:]


def likewise(notes: Sequence[str], limit: int = 8) -> list[str]:
    """Return notes of records, those that differ in the record, in numbers and in brackets only as one.

    Parameters
    ----------
    notes : sequence of str
        Sentences; what is about one record begins with its name and a colon.
    limit : int, default 8
        Records that are named beside the first.

    Examples
    --------
    >>> likewise(["a: warning: 2 lost", "b: warning: 3 lost", "warning: it drifts"])
    ['a: warning: 2 lost; likewise b', 'warning: it drifts']
    """
    groups: dict[str, list[str]] = {}
    for note in notes:
        _, colon, said = note.partition(": ")
        is_own = bool(colon) and said.startswith("warning: ")
        groups.setdefault(_NUMBERED.sub("#", said) if is_own else note, []).append(note)
    told = []
    for first, *others in groups.values():
        names = [note.partition(": ")[0] for note in others]
        names = [name for name in dict.fromkeys(names) if name != first.partition(": ")[0]]
        rest = f" and {len(names) - limit} more" if len(names) > limit else ""
        told.append(f"{first}; likewise {', '.join(names[:limit])}{rest}" if names else first)
    return told


def natural_key(text: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key that puts ``run_2`` before ``run_10``.

    Examples
    --------
    >>> sorted(["run_10", "run_2"], key=natural_key)
    ['run_2', 'run_10']
    """
    parts = re.split(r"([0-9]+)", text)
    key = [(0, int(part), "") if i % 2 and len(part) < 4000 else (1, 0, part.lower()) for i, part in enumerate(parts)]
    return (*key, (2, 0, text))
