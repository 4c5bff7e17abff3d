"""Text from files made safe and short for messages, and sorted as people sort it."""

from __future__ import annotations

import re

_PEOPLE = {"bouc-wen": "Bouc-Wen", "coulomb": "Coulomb", "hertzian": "Hertzian", "iwan": "Iwan", "jenkins": "Jenkins"}
"""Names of people in the names of effects and parameters."""
_HYPHENATED = ("bouc-wen", "displacement-dependent")
"""Words of such names that belong together."""


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
    >>> in_words("coulomb_friction"), in_words("bouc_wen_stiffness"), in_words("quadratic_damping")
    ('Coulomb friction', 'Bouc-Wen stiffness', 'quadratic damping')
    """
    for joined in _HYPHENATED:
        name = name.replace(joined.replace("-", "_"), joined)
    return " ".join(_PEOPLE.get(word, word) for word in name.split("_"))


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
