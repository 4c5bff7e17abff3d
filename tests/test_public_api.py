"""Public equals documented: every public name explains what it takes, returns and refuses, as its signature says."""

from __future__ import annotations

import ast
import dataclasses
import enum
import inspect
import json
import re
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

import pymc_backbone

ROOT = Path(__file__).resolve().parents[1]
SECTIONS = ("Parameters", "Attributes", "Returns", "Yields", "Raises", "Notes", "Examples", "References", "See Also")


def public_values() -> dict[str, object]:
    """All public values by the name that stands after ``pb.``: of the package, and of its public modules."""
    found: dict[str, object] = {}
    for name in pymc_backbone.__all__:
        value = getattr(pymc_backbone, name)
        if inspect.ismodule(value):
            found |= {f"{name}.{inner}": getattr(value, inner) for inner in value.__all__}
        else:
            found[name] = value
    return found


PUBLIC = public_values()
MODULES = [name for name in pymc_backbone.__all__ if inspect.ismodule(getattr(pymc_backbone, name))]
CLASSES = sorted(name for name, value in PUBLIC.items() if inspect.isclass(value))
FUNCTIONS = sorted(name for name, value in PUBLIC.items() if callable(value) and name not in CLASSES)


def sections_of(text: str) -> dict[str, str]:
    """Return the sections of a numpydoc text; the summary stands under an empty name."""
    pattern = rf"^({'|'.join(SECTIONS)})\n-+\n"
    pieces = re.split(pattern, text + "\n", flags=re.MULTILINE)
    return {"": pieces[0], **dict(zip(pieces[1::2], pieces[2::2], strict=True))}


def entries_of(section: str) -> list[str]:
    """Return the names that a section explains; those of one line, with commas between, apart."""
    heads = [line.partition(" : ")[0] for line in section.splitlines() if line and not line.startswith(" ")]
    return [name.strip().lstrip("*") for head in heads for name in head.split(",")]


def parameters_of(function: object) -> list[str]:
    return [name for name in inspect.signature(function).parameters if name not in ("self", "cls")]


def raises(function: object) -> bool:
    """Whether the function itself, not what it calls, ends in an error of the user's."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    return any(
        isinstance(node, ast.Raise) and node.exc is not None and "InputError" in ast.unparse(node.exc)
        for node in ast.walk(tree)
    )


def missing_words(name: str, function: object, documented: str) -> list[str]:
    """Return what is wrong with a docstring, in words."""
    found = sections_of(documented)
    wrong = []
    summary = found[""].strip().split("\n\n")[0]
    if not summary or not summary.rstrip().endswith("."):
        wrong.append("the summary is no sentence")
    expected, explained = parameters_of(function), entries_of(found.get("Parameters", ""))
    if explained != expected:
        wrong.append(f"explains {explained}, takes {expected}")
    returned = inspect.signature(function).return_annotation
    if not inspect.isclass(function) and returned not in (None, "None") and not {"Returns", "Yields"} & set(found):
        wrong.append("does not say what it returns")
    if not inspect.isclass(function) and raises(function) and "Raises" not in found:
        wrong.append("does not say what it raises")
    empty = [title for title, content in found.items() if not content.strip()]
    return [f"{name}: {words}" for words in (*wrong, *(f"empty section {title}" for title in empty))]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_are_documented_by_their_signature(name):
    function = PUBLIC[name]
    assert missing_words(name, function, inspect.getdoc(function) or "") == []


@pytest.mark.parametrize("name", CLASSES)
def test_classes_are_documented_by_their_fields_or_arguments(name):
    """Arguments of the constructor stand in the docstring of the class; results list their attributes."""
    cls = PUBLIC[name]
    text = inspect.getdoc(cls) or ""
    assert text.split("\n\n")[0].rstrip().endswith("."), name
    if issubclass(cls, Exception | enum.Enum):
        return
    found = sections_of(text)
    explained = entries_of(found.get("Parameters", "")) + entries_of(found.get("Attributes", ""))
    wanted = [field.name for field in dataclasses.fields(cls)] if dataclasses.is_dataclass(cls) else parameters_of(cls)
    public = [field for field in wanted if not field.startswith("_")]
    assert set(public) <= set(explained), f"{name} does not explain {sorted(set(public) - set(explained))}"
    there = {*public, *dir(cls)}
    assert set(explained) <= there, f"{name} explains {sorted(set(explained) - there)}, which it has not"


@pytest.mark.parametrize("name", CLASSES)
def test_public_methods_are_documented(name):
    cls = PUBLIC[name]
    if cls.__module__.startswith("pymc_backbone") and not issubclass(cls, Exception | enum.Enum):
        for attribute, value in vars(cls).items():
            if attribute.startswith("_") or not (inspect.isfunction(value) or isinstance(value, property)):
                continue
            if any(hasattr(base, attribute) for base in cls.__mro__[1:]):
                continue  # the base class says what it is
            text = inspect.getdoc(value) or ""
            assert text.split("\n\n")[0].rstrip().endswith("."), f"{name}.{attribute}"
            if inspect.isfunction(value) and "Parameters\n---" in text:
                assert entries_of(sections_of(text)["Parameters"]) == parameters_of(value), f"{name}.{attribute}"


def related(text: str) -> list[str]:
    """Return the names in the *See Also* of a docstring, each with words on why."""
    lines = [line for line in sections_of(text).get("See Also", "").splitlines() if line.strip()]
    assert all(re.fullmatch(r"[\w.]+ : .+\.|    .+", line) for line in lines), lines
    return [line.partition(" : ")[0] for line in lines if not line.startswith(" ")]


@pytest.mark.parametrize("name", [*FUNCTIONS, *CLASSES])
def test_public_names_lead_to_each_other(name):
    names = related(inspect.getdoc(PUBLIC[name]) or "")
    assert names, f"{name} has no See Also"
    assert set(names) <= set(PUBLIC), f"{name} leads to {sorted(set(names) - set(PUBLIC))}, which is not public"
    assert name not in names


def test_the_check_sees_what_is_missing():
    """Negative controls."""

    def function(first: int, second: int = 2) -> int:
        raise pymc_backbone.InputError("no.")

    text = "Do it.\n\nParameters\n----------\nfirst : int\n    One.\n"
    words = " ".join(missing_words("f", function, text))
    assert "explains ['first'], takes ['first', 'second']" in words
    assert "returns" in words and "raises" in words
    whole = (
        text
        + "second : int\n    Two.\n\nReturns\n-------\nint\n    Three.\n\nRaises\n------\nInputError\n    Always.\n"
    )
    assert missing_words("f", function, whole) == []
    assert "no sentence" in missing_words("f", function, whole.replace("Do it.", "it"))[0]


def test_nothing_public_is_left_out_of_the_list():
    """Names without an underscore that the package itself holds are the documented ones."""
    named = {name for names in pymc_backbone._WHERE.values() for name in names}
    assert named | set(pymc_backbone._NAMESPACES) == set(pymc_backbone.__all__) and set(MODULES) == {"paper", "plots"}
    for name in pymc_backbone.__all__:
        getattr(pymc_backbone, name)
    extra = {name for name in vars(pymc_backbone) if not name.startswith("_")} - set(pymc_backbone.__all__)
    modules = {name for name in extra if inspect.ismodule(getattr(pymc_backbone, name))}
    assert extra - modules - {"annotations", "Any", "PackageNotFoundError", "TYPE_CHECKING", "version"} == set()


def loaded_by(code: str) -> set[str]:
    """Return the modules that a new process has loaded after ``code`` and had not after ``before``."""
    program = f"import sys\n{code}\nprint('\\n'.join(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.parametrize("first", ["import pymc", "pass"])
def test_import_loads_nothing_beside_itself(first):
    """Names come from their modules when they are first used; so the import costs next to nothing over PyMC's."""
    found = loaded_by(f"{first}\nbefore = set(sys.modules)\nimport pymc_backbone")
    ours = {name for name in found if name.partition(".")[0] == "pymc_backbone"}
    assert ours == {"pymc_backbone"}
    foreign = {name.partition(".")[0] for name in found - ours} - set(sys.stdlib_module_names)
    assert foreign == set()


def test_only_figures_and_reports_load_the_plotting():
    """All names but these leave matplotlib, nutpie and pyuff alone."""
    names = [name for name in pymc_backbone.__all__ if name not in ("write_study", "plots")]
    code = "import pymc\nbefore = set(sys.modules)\nimport pymc_backbone\n"
    code += "".join(f"pymc_backbone.{name}\n" for name in names)
    tops = {name.partition(".")[0] for name in loaded_by(code)}
    assert not tops & {"matplotlib", "arviz_plots", "nutpie", "pyuff", "dask", "IPython"}
    for name in ("write_study", "plots"):  # negative control: the check above would see it
        assert "matplotlib" in loaded_by(f"import pymc_backbone\nbefore = set(sys.modules)\npymc_backbone.{name}")


def test_public_modules_can_be_imported_by_their_names():
    from pymc_backbone.paper import CASES
    from pymc_backbone.plots import plot_pair

    assert pymc_backbone.paper.CASES is CASES and pymc_backbone.plots.plot_pair is plot_pair
    assert set(pymc_backbone.paper.__all__) <= set(dir(pymc_backbone.paper))
    for module in (pymc_backbone, pymc_backbone.paper):
        with pytest.raises(AttributeError, match="no attribute 'nothing'"):
            _ = module.nothing


def code_of(path: Path) -> str:
    """Return the Python that a script, a notebook or a page holds, without the magic commands of notebooks."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        return text
    if path.suffix == ".ipynb":
        blocks = ["".join(cell["source"]) for cell in json.loads(text)["cells"] if cell["cell_type"] == "code"]
    else:
        begin = r"^```(?:python|\{code-cell\} ipython3)\n"
        blocks = re.findall(rf"{begin}(.*?)^```", text, flags=re.DOTALL | re.MULTILINE)
    return "\n".join(line for block in blocks for line in block.splitlines() if not line.startswith(("%", ":")))


def not_public(code: str) -> list[str]:
    """Return what code takes from the package that is not public: imports, and names after ``pb.``."""
    wrong = []
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import):
            wrong += [a.name for a in node.names if a.name.startswith("pymc_backbone.") and a.name[14:] not in MODULES]
        elif isinstance(node, ast.ImportFrom) and str(node.module).partition(".")[0] == "pymc_backbone":
            inside = str(node.module).partition(".")[2]
            full = [f"{inside}.{alias.name}".lstrip(".") for alias in node.names]
            wrong += [name for name in full if name not in (*PUBLIC, *MODULES)]
        elif isinstance(node, ast.Attribute):
            parts = ast.unparse(node).split(".")
            if parts[0] == "pb" and all(map(str.isidentifier, parts)) and parts[1] not in ("__version__", "__file__"):
                depth = 3 if parts[1] in MODULES else 2
                if len(parts) >= depth and ".".join(parts[1:depth]) not in PUBLIC:
                    wrong.append(".".join(parts))
    return wrong


PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("[!_]*/*.md"))]
SHOWN = [path for path in PAGES if "pb." in code_of(path)] + sorted((ROOT / "examples").rglob("*.py"))
SHOWN += sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", SHOWN, ids=[path.relative_to(ROOT).as_posix() for path in SHOWN])
def test_what_readers_copy_takes_only_public_names(path):
    code = code_of(path)
    assert "pymc_backbone" in code or "pb." in code
    assert not_public(code) == []


def test_what_is_not_public_is_found():
    """Negative controls."""
    assert not_public("import pymc_backbone as pb\npb.sample; pb.paper.CASES['1'].draw; pb.plots.plot_pair(x)") == []
    assert not_public("from pymc_backbone.paper import CASES\nfrom pymc_backbone import plots, Record") == []
    for code in (
        "from pymc_backbone.paper.cases import CASES",
        "import pymc_backbone.oscillator",
        "from pymc_backbone import oscillator",
        "from pymc_backbone.paper import uniform_bounds",
        "pb.nothing",
        "pb.plots.Figure",
    ):
        assert len(not_public(code)) == 1, code


@pytest.mark.parametrize("old", pymc_backbone._RENAMED)
def test_old_names_work_and_say_what_they_are_called_now(old):
    new = pymc_backbone._RENAMED[old]
    with pytest.warns(FutureWarning, match=f"{old} is now called {new}"):
        found = getattr(pymc_backbone, old)
    assert found is getattr(pymc_backbone, new)
    assert new in pymc_backbone.__all__ and old not in pymc_backbone.__all__
    assert f"`{old}`" in (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
