"""A digest of compiled functions and of everything they refer to: changed code is never taken for the old."""

from __future__ import annotations

import hashlib
from enum import Enum
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np


class FunctionDigest:
    """SHA-256 over functions and everything they refer to."""

    # Changes inside these come with a new version of the package, of which other parts of a cache key take care.
    _FOREIGN = frozenset({"builtins", "cmath", "math", "numba", "numpy", "operator", "scipy"})

    def __init__(self) -> None:
        self._hash = hashlib.sha256()
        self._seen: dict[tuple[int, frozenset[str]], tuple[int, object]] = {}

    def add(self, *texts: str) -> None:
        """Add texts, each with its length in front, so that no two sequences look alike."""
        for text in texts:
            data = text.encode()
            self._hash.update(f"{len(data)}:".encode() + data)

    def hexdigest(self) -> str:
        """Return the digest so far."""
        return self._hash.hexdigest()

    def visit(self, value: Any, names: frozenset[str] = frozenset()) -> None:
        """Add a value; of a module or class, the attributes among ``names``."""
        if isinstance(value, Enum):
            self.add(type(value).__qualname__, value.name, repr(value.value))
        elif isinstance(value, bool | int | float | complex | str | bytes | type(None) | np.generic):
            self.add(type(value).__name__, repr(value))
        elif isinstance(value, tuple | list):
            self.add(type(value).__name__, str(len(value)))
            for item in value:
                self.visit(item, names)
        elif isinstance(value, set | frozenset):
            self.add("set", *sorted(map(repr, value)))
        elif isinstance(value, dict):
            self.add("dict", str(len(value)))
            for key in sorted(value, key=repr):
                self.visit(key)
                self.visit(value[key], names)
        elif isinstance(value, np.ndarray):
            self.add("array", str(value.dtype), str(value.shape))
            self._hash.update(value.tobytes())
        else:
            # Of a module or class only the attributes in use count, so that these are part of what has been seen.
            key = (id(value), names if isinstance(value, ModuleType | type) else frozenset())
            if key in self._seen:
                self.add("seen", str(self._seen[key][0]))
            else:
                # The value is kept beside its number: a freed object's id may be used again.
                self._seen[key] = (len(self._seen), value)
                self._visit_once(value, names)

    def _visit_once(self, value: Any, names: frozenset[str]) -> None:
        module = value.__name__ if isinstance(value, ModuleType) else str(getattr(value, "__module__", ""))
        if module.split(".")[0] in self._FOREIGN and not hasattr(value, "py_func"):
            self.add("foreign", module, str(getattr(value, "__qualname__", getattr(value, "__name__", type(value)))))
        elif isinstance(value, ModuleType | type):
            # Its own name does not matter: what counts is what the names used in it stand for.
            self.add("namespace")
            for name in sorted(names & vars(value).keys()):
                self.add(name)
                self.visit(vars(value)[name], names)
        elif isinstance(value, FunctionType):
            self._visit_function(value)
        elif hasattr(value, "py_func"):
            self.add("compiled")
            self.visit(getattr(value, "targetoptions", None))
            self.visit(value.py_func)
        elif isinstance(value, CodeType):
            self._visit_code(value)
        else:
            self.add("object", module, type(value).__qualname__, str(getattr(value, "__name__", "")))

    def _visit_function(self, function: FunctionType) -> None:
        self.add("function")
        self.visit(function.__code__)
        self.visit(function.__defaults__)
        self.visit(function.__kwdefaults__)
        names = _referenced_names(function.__code__)
        for name in sorted(names & function.__globals__.keys()):
            self.add("global", name)
            self.visit(function.__globals__[name], names)
        for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
            self.add("closure", name)
            try:
                contents = cell.cell_contents
            except ValueError:  # a variable not assigned yet
                continue
            self.visit(contents, names)

    def _visit_code(self, code: CodeType) -> None:
        self.add("code", str(code.co_argcount), str(code.co_flags))
        self.add(*code.co_names, *code.co_varnames, *code.co_freevars, *code.co_cellvars)
        self._hash.update(code.co_code + code.co_exceptiontable)
        self.visit(code.co_consts)


def _referenced_names(code: CodeType) -> frozenset[str]:
    """Return the names of globals and attributes in a code object and those nested in it."""
    names = set(code.co_names)
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            names |= _referenced_names(constant)
    return frozenset(names)
