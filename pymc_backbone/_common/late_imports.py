"""Imports at another time: behind that of a library, whoever asks for it; beside other work, in a thread."""

from __future__ import annotations

import importlib.util
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType


class _Waiting(MetaPathFinder):
    """Finds one module as it would be found without this, and has something done behind its import."""

    def __init__(self, name: str, action: Callable[[], None]) -> None:
        self.name, self.action = name, action

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the module's own spec, with a loader that does the rest afterwards."""
        if fullname != self.name:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is None or spec.loader is None:
            return spec
        load = spec.loader.exec_module

        def load_and_act(module: ModuleType) -> None:
            load(module)
            self.action()

        spec.loader.exec_module = load_and_act  # type: ignore[method-assign]
        return spec


def after_import(name: str, action: Callable[[], None]) -> None:
    """Call ``action`` once the module ``name`` is imported: now, where it is already, or whenever somebody does so.

    Parameters
    ----------
    name : str
        Full name of a module that may not be installed.
    action : callable
        Without arguments.
    """
    if name in sys.modules:
        action()
    else:
        sys.meta_path.insert(0, _Waiting(name, action))


@contextmanager
def imported_beside(*names: str) -> Iterator[None]:
    """Import modules in a thread while the body runs; they are there, and the thread gone, at the end.

    An import that fails says nothing: it fails again where the module is needed.
    """

    def load() -> None:
        for name in names:
            with suppress(Exception):
                importlib.import_module(name)

    thread = threading.Thread(target=load, name="imports", daemon=True)
    thread.start()
    yield  # where the body raises, nobody waits: the thread ends by itself or with the process
    thread.join()
