"""Options that belong together as frozen dataclasses: picked out of settings by name, and written as settings.

Each stands beside what it configures; its defaults are the only ones, for Python and for the command line.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def pick[Options: DataclassInstance](kind: type[Options], settings: Mapping[str, Any]) -> Options:
    """Return the options of one kind that are among ``settings``, the others as they are by default.

    Examples
    --------
    >>> from pymc_backbone.measurement.options import Measuring
    >>> pick(Measuring, {"levels": 8, "draws": 100})
    Measuring(band=None, start=None, stop=None, levels=8, observables=None, strict=False, floor=None)
    """
    return kind(**{name: settings[name] for name in names_of(kind) if name in settings})


def names_of(kind: type[DataclassInstance]) -> tuple[str, ...]:
    """Return the names of the options of one kind."""
    return tuple(item.name for item in fields(kind))


def settings_of(*options: DataclassInstance) -> dict[str, Any]:
    """Return the values of several kinds of options by name, as `pick` takes them."""
    return {name: getattr(item, name) for item in options for name in names_of(type(item))}
