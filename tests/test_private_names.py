"""What is used of numba, PyMC and PyTensor beyond their stated interfaces, in one place.

None of it is promised to stay. So numba has an upper bound in `pyproject.toml`, and where something here has gone or
changed, the message says what it was used for, and where to look.
"""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import re
import tomllib
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pymc as pm
import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "pymc_backbone"
# Modules of these packages that they describe for everybody.
STATED = {"numba", "numba.types", "numba.extending", "llvmlite", "llvmlite.binding", "pymc", "pytensor"}
STATED |= {"pytensor.tensor", "pytensor.gradient", "pytensor.graph.basic", "pytensor.graph.fg", "pytensor.graph.op"}

IMPORTED = {
    "numba.core.cgutils": {"simulation/pointers.py", "simulation/counts.py"},
    "numba.core.typing.signature": {"simulation/pointers.py", "simulation/counts.py"},
    "numba.np.arrayobj.populate_array": {"simulation/pointers.py"},
    "numba.core.caching.FunctionCache": {"_common/compiled.py"},
    "numba.core.ccallback.CFunc": {"_common/compiled.py"},
    "pymc.distributions.transforms.Interval": {"inference/starts.py"},
    "pymc.exceptions.SamplingError": {"inference/store/recorder.py"},
    "pymc.pytensorf.floatX": {"inference/proposal.py"},
    "pymc.pytensorf.join_nonshared_inputs": {"inference/remembering.py"},
    "pymc.step_methods.metropolis.MetropolisState": {"inference/proposal.py"},
    "pymc.step_methods.state.DataClassState": {"inference/store/step_state.py"},
    "pymc.step_methods.state.WithSamplingState": {"inference/store/step_state.py"},
    "pymc.step_methods.state.dataclass_state": {"inference/proposal.py"},
    "pymc.util.RandomGeneratorState": {"inference/store/step_state.py"},
    "pymc.util.get_state_from_generator": {"inference/store/step_state.py"},
    "pytensor.compile.mode.Mode": {"inference/remembering.py", "inference/starts.py"},
    "pytensor.compile.sharedvalue.SharedVariable": {"inference/targets.py"},
    "pytensor.graph.rewriting.basic.node_rewriter": {"likelihood/op.py", "inference/start_hint.py"},
    "pytensor.graph.traversal.applys_between": {"inference/targets.py"},
    "pytensor.link.jax.dispatch.basic.jax_funcify": {"likelihood/jax_bridge.py"},
    "pytensor.link.numba.dispatch.basic.generate_fallback_impl": {"likelihood/curvature.py"},
    "pytensor.link.numba.dispatch.basic.register_funcify_and_cache_key": {
        "likelihood/op.py",
        "likelihood/curvature.py",
    },
    "pytensor.scalar.basic.Cast": {"inference/targets.py"},
    "pytensor.tensor.blockwise.Blockwise": {"likelihood/op.py"},
    "pytensor.tensor.rewriting.basic.register_canonicalize": {"inference/start_hint.py"},
    "pytensor.tensor.rewriting.basic.register_specialize": {"likelihood/op.py"},
    "pytensor.tensor.type.TensorType": {"inference/start_hint.py"},
}


@functools.cache
def imports() -> dict[str, set[str]]:
    """Return what the package imports from unstated modules: each name with the files that do."""
    found: dict[str, set[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ImportFrom) or node.level or node.module in STATED or node.module is None:
                continue
            if node.module.partition(".")[0] in ("numba", "llvmlite", "pymc", "pytensor"):
                for alias in node.names:
                    where = path.relative_to(PACKAGE).as_posix()
                    found.setdefault(f"{node.module}.{alias.name}", set()).add(where)
    return found


def test_the_list_of_imports_is_whole():
    assert imports() == IMPORTED, "enter what is new into IMPORTED, take out what is gone"


@pytest.mark.parametrize("name", IMPORTED)
def test_what_is_imported_is_there(name):
    if ".jax." in name:
        pytest.importorskip("jax", reason="JAX is not installed, and nothing of it is imported then")
    package = name.partition(".")[0]
    module, _, last = name.rpartition(".")
    try:
        there = hasattr(importlib.import_module(module), last)
    except ImportError:
        there = False
    assert there, f"{package} {version(package)} has no {name} any more; {', '.join(sorted(IMPORTED[name]))} needs it"


@numba.njit
def _compiled(x):
    return x + 1.0


def _slice_step() -> Any:
    with pm.Model():
        pm.Normal("x")
        return pm.Slice()


# What is read or written of objects that are not the package's own: what for, where, and whether it is there.
TOUCHED = {
    "_cache of a dispatcher of numba (compiled code on disk under a digest): _common/compiled.py": lambda: hasattr(
        _compiled, "_cache"
    ),
    "py_func and targetoptions of a dispatcher of numba: _common/compiled.py": lambda: (
        callable(_compiled.py_func) and isinstance(_compiled.targetoptions, dict)
    ),
    "_index_key(sig, codegen) of numba's FunctionCache (the digest in its key): _common/compiled.py": lambda: (
        list(inspect.signature(_of("numba.core.caching.FunctionCache")._index_key).parameters)
        == ["self", "sig", "codegen"]
    ),
    "CFunc(function, signature, locals, options) of numba: _common/compiled.py": lambda: (
        list(inspect.signature(_of("numba.core.ccallback.CFunc")).parameters)[:4]
        == ["pyfunc", "sig", "locals", "options"]
    ),
    "the flag nrt of numba's njit (no reference counting): simulation/forces.py": lambda: (
        numba.njit(lambda x: x, _nrt=False)(1.0) == 1.0
    ),
    "delta_logp of PyMC's Metropolis and DEMetropolisZ: inference/remembering.py": lambda: all(
        "self.delta_logp(" in inspect.getsource(step.astep) for step in (pm.Metropolis, pm.DEMetropolisZ)
    ),
    "logp of PyMC's Slice: inference/remembering.py": lambda: "self.logp" in inspect.getsource(pm.Slice.astep),
    "var_names and shared of PyMC's steps: inference/remembering.py": lambda: (
        _slice_step().var_names == ("x",) and _slice_step().shared == {}
    ),
    "proposal_dist, accept_rate_iter, elemwise_update of PyMC's Metropolis: inference/proposal.py": lambda: all(
        f"self.{name}" in inspect.getsource(pm.Metropolis.astep)
        for name in ("proposal_dist", "accept_rate_iter", "accepted_iter", "accepted_sum", "elemwise_update")
    ),
    "_state_class of PyMC's steps: inference/proposal.py, inference/store/step_state.py": lambda: (
        pm.Metropolis._state_class is _of("pymc.step_methods.metropolis.MetropolisState")
    ),
    "dist_params(node) and fgraph of PyMC's symbolic variables: inference/targets.py": lambda: (
        _symbolic_variable().owner.op.fgraph is not None
        and len(_symbolic_variable().owner.op.dist_params(_symbolic_variable().owner)) == 1
    ),
    "make_initial_point_fn of PyMC: inference/starts.py": lambda: (
        {"model", "default_strategy"} <= set(inspect.signature(pm.initial_point.make_initial_point_fn).parameters)
    ),
}


def _of(name: str) -> Any:
    module, _, last = name.rpartition(".")
    return getattr(importlib.import_module(module), last)


def _symbolic_variable() -> Any:
    return pm.CustomDist.dist(np.zeros(2), dist=lambda mu, size: pm.Normal.dist(mu, size=size))


@pytest.mark.parametrize("what", TOUCHED)
def test_what_is_touched_is_there(what):
    try:
        there = TOUCHED[what]()
    except (AttributeError, TypeError, KeyError, ImportError) as error:
        there, what = False, f"{what} ({error})"
    assert there, f"gone or changed: {what}"


def test_a_check_of_this_kind_can_fail(monkeypatch):
    monkeypatch.setattr(pm.Slice, "astep", lambda self, point: point)
    assert not TOUCHED["logp of PyMC's Slice: inference/remembering.py"]()


@pytest.mark.parametrize("package", ["numba", "pymc", "pytensor"])
def test_the_bounds_hold_what_is_installed(package):
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    [found] = [Requirement(text) for text in listed if re.split(r"[^\w-]", text)[0] == package]
    assert any(part.operator == "<" for part in found.specifier), f"{package} needs an upper bound"
    assert found.specifier.contains(version(package)), "raise the bound only with these tests passing"
