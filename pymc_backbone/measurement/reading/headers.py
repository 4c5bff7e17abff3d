"""Words by which column headers, channels and variables name time and measured quantities."""

from __future__ import annotations

import re
import unicodedata

QUANTITIES: tuple[str, ...] = ("displacement", "velocity", "acceleration")
ENVELOPE = "envelope"
"""What a record holds that is amplitude or power over time, without the oscillation."""
READABLE: tuple[str, ...] = (*QUANTITIES, ENVELOPE)
"""What a channel may be said to hold."""
QUANTITY_WORDS = {
    "displacement": {
        "displacement", "disp", "deflection", "position", "angle", "rotation",
        "auslenkung", "weg", "winkel", "verschiebung", "deplacement",
    },
    "velocity": {"velocity", "vel", "geschwindigkeit", "schwinggeschwindigkeit", "vitesse"},
    "acceleration": {"acceleration", "acc", "accel", "beschleunigung"},
}  # fmt: skip
ENVELOPE_WORDS = {
    "envelope",
    "magnitude",
    "power",
    "einhuellende",
    "einhullende",
    "huellkurve",
    "hullkurve",
    "betrag",
    "leistung",
}
AMPLITUDE_WORDS = {"amplitude", "amplituden"}
"""Loggers call a waveform so, too: such a column is an envelope where no value is negative."""
FREQUENCY_WORDS = {"frequency", "freq", "frequenz", "frequence", "frecuencia"}
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


def is_envelope_name(name: str) -> bool:
    """Return whether a name is that of an envelope: by its words, or the R of a lock-in amplifier.

    Examples
    --------
    >>> [is_envelope_name(name) for name in ("Envelope", "Demod 1 R", "R", "amplitude", "resistance R1 x")]
    [True, True, True, True, False]
    """
    words = set(words_of(name))
    if words & (ERROR_WORDS | TIME_WORDS):
        return False
    is_lock_in = re.fullmatch(
        r"(?:(?:demod\w*|lock-?in|ch\w*)[\s._-]*\d*[\s._-]*)?r(?:[\s._-]*\d+)?", name.strip().lower()
    )
    return bool(words & (ENVELOPE_WORDS | AMPLITUDE_WORDS)) or is_lock_in is not None


def may_be_waveform(name: str) -> bool:
    """Return whether a name is that of an envelope by a word only by which loggers call waveforms, too."""
    words = set(words_of(name))
    return bool(words & AMPLITUDE_WORDS) and not words & ENVELOPE_WORDS


def is_frequency(name: str) -> bool:
    """Return whether a word for frequency is among the words of a name."""
    words = set(words_of(name))
    return bool(words & FREQUENCY_WORDS) and not words & ERROR_WORDS
