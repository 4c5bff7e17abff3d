"""Words by which column headers, channels and variables name time and measured quantities."""

from __future__ import annotations

import re
import unicodedata

QUANTITIES: tuple[str, ...] = ("displacement", "velocity", "acceleration")
QUANTITY_WORDS = {
    "displacement": {
        "displacement", "disp", "deflection", "position", "angle", "rotation",
        "auslenkung", "weg", "winkel", "verschiebung", "deplacement",
    },
    "velocity": {"velocity", "vel", "geschwindigkeit", "schwinggeschwindigkeit", "vitesse"},
    "acceleration": {"acceleration", "acc", "accel", "beschleunigung"},
}  # fmt: skip
FORCE_WORDS = {"force", "hammer", "kraft", "hammerkraft", "impuls", "marteau", "fuerza"}
ANGLE_WORDS = {"angle", "rotation", "angular", "winkel"}
TIME_WORDS = {
    "time", "t", "timestamp", "datetime", "seconds", "zeit", "uhrzeit", "zeitstempel", "temps", "tempo", "tiempo",
}  # fmt: skip
ERROR_WORDS = {"error", "se", "sd", "std"}
RATE_WORDS = {"fs", "samplerate", "samplingrate", "samplefrequency", "samplingfrequency", "sr", "abtastrate"}
STEP_WORDS = {"dt", "deltat", "timestep", "samplingperiod", "sampleperiod", "sampleinterval", "samplinginterval"}


def words_of(name: str) -> list[str]:
    """Return the words of a header in lower case, without accents.

    Examples
    --------
    >>> words_of("Tip_Accel 1")
    ['tip', 'accel']
    """
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode()
    return re.findall(r"[a-z]+", plain.lower())


def key_of(name: str) -> str:
    """Return a name without case, blanks and signs, to compare it with `RATE_WORDS` and `STEP_WORDS`."""
    return "".join(words_of(name))


def is_time(name: str) -> bool:
    """Return whether a name is a word for time, with a number as in ``t_1`` at most."""
    return re.sub(r"_\d+$", "", name.lower().strip()) in TIME_WORDS


def mentions_time(name: str) -> bool:
    """Return whether a word for time is among the words of a name."""
    return bool((TIME_WORDS - {"t", "seconds"}) & set(words_of(name)))


def quantity_of_name(name: str) -> str | None:
    """Return the quantity that a name states; ``angle velocity`` is a velocity."""
    words = set(words_of(name))
    if words & ERROR_WORDS or words & TIME_WORDS or name.lower() == "specimen":
        return None
    return next((quantity for quantity in reversed(QUANTITIES) if words & QUANTITY_WORDS[quantity]), None)


def is_angle_name(name: str) -> bool:
    """Return whether a name speaks of a rotation."""
    return bool(ANGLE_WORDS & set(words_of(name)))
