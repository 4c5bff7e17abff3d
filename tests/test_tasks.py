"""What stands around the code holds together: tasks, workflows, hooks, tested versions, and how long modules are."""

from __future__ import annotations

import ast
import io
import re
import subprocess
import sys
import tokenize
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
CONSTRAINTS = (ROOT / "constraints.txt").read_text(encoding="utf-8")
LONGEST = 300  # lines of code of a module, without docstrings, comments and blanks; CONTRIBUTING.md says why
# The step of the integrator is generated, and one subject.
LONGER = {"simulation/stepper.py": 360}


def sessions() -> set[str]:
    """Return the tasks that noxfile.py has."""
    text = (ROOT / "noxfile.py").read_text(encoding="utf-8")
    return set(re.findall(r"^@nox\.session\ndef (\w+)", text, flags=re.MULTILINE))


def commands(path: Path) -> list[str]:
    """Return what a workflow runs, line by line."""
    yaml = pytest.importorskip("yaml", reason="comes with pre-commit, in the group dev")
    jobs = yaml.safe_load(path.read_text(encoding="utf-8"))["jobs"]
    return [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]


def code_lines(text: str) -> int:
    """Count the lines of a module that hold code: no docstring, no comment, not blank."""
    described: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            described |= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type in (tokenize.NAME, tokenize.OP, tokenize.NUMBER, tokenize.STRING, tokenize.FSTRING_START):
            code |= set(range(token.start[0], token.end[0] + 1))
    return len(code - described)


def too_long(package: Path) -> dict[str, int]:
    """Return the modules of a package that have more lines of code than the rule allows."""
    found = {}
    for path in package.rglob("*.py"):
        name, length = path.relative_to(package).as_posix(), code_lines(path.read_text(encoding="utf-8"))
        if length > LONGER.get(name, LONGEST):
            found[name] = length
    return found


def test_no_module_is_too_long():
    assert too_long(ROOT / "pymc_backbone") == {}, "what does it do twice, or beside its one thing?"
    assert f"at most {LONGEST} lines of code" in (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert all((ROOT / "pymc_backbone" / name).exists() for name in LONGER)


def test_a_module_that_is_too_long_is_found(tmp_path):
    """Negative control; what explains the code does not count."""
    (tmp_path / "long.py").write_text("x = 1\n" * (LONGEST + 1))
    (tmp_path / "short.py").write_text('"""Why.\n\nMore.\n"""\n\n# because\n' + "x = 1\n" * LONGEST)
    assert too_long(tmp_path) == {"long.py": LONGEST + 1}


@pytest.mark.parametrize("path", WORKFLOWS, ids=[path.stem for path in WORKFLOWS])
def test_workflows_run_what_the_readme_and_nox_know(path):
    for command in commands(path):
        if "pip install uv" in command or "GITHUB_REF_NAME" in command or "uv publish" in command:
            continue
        words = command.split()
        assert words[1:4] == ["-m", "uv", "run"], command
        if words[4] == "nox":
            assert set(words[6:]) <= {*sessions(), '"$SESSION"'}, command
        else:
            assert words[4] == "pytest" and (ROOT / words[-1]).exists(), command
    if path.stem == "nightly":
        (names,) = re.findall(r"session: \[(.*)\]", path.read_text(encoding="utf-8"))
        assert set(names.split(", ")) <= sessions()


def test_workflows_test_every_python_that_is_promised():
    text = (ROOT / ".github" / "workflows" / "tests.yml").read_text(encoding="utf-8")
    promised = [line.rpartition(" ")[2] for line in PYPROJECT["project"]["classifiers"] if "Python :: 3." in line]
    (tested,) = re.findall(r"python: \[(.*)\]", text)
    assert set(promised) <= set(re.findall(r"3\.\d+", tested))
    for system in ("ubuntu", "macos", "windows"):
        assert f"{system}-latest" in text


def test_workflow_files_are_well_formed():
    """Schema and the linter of workflows; without a network."""
    pytest.importorskip("nox", reason="in the group dev")
    command = [sys.executable, "-m", "nox", "-s", "workflows"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_careless_workflow_is_found(tmp_path):
    """Negative control: a title of a stranger's pull request that the shell would run."""
    pytest.importorskip("nox", reason="in the group dev")
    careless = tmp_path / ".github" / "workflows" / "careless.yml"
    careless.parent.mkdir(parents=True)
    lines = ["on: pull_request_target", "jobs:", "  a:", "    runs-on: ubuntu-latest", "    steps:"]
    careless.write_text("\n".join([*lines, "      - run: echo ${{ github.event.pull_request.title }}", ""]))
    program = Path(sys.executable).with_name("zizmor")
    done = subprocess.run([program, "--offline", careless], capture_output=True, text=True, check=False)
    assert done.returncode != 0 and "template-injection" in done.stdout


def direct_requirements() -> list[str]:
    groups = PYPROJECT["dependency-groups"]
    extras = PYPROJECT["project"]["optional-dependencies"].values()
    listed = [*PYPROJECT["project"]["dependencies"], *(entry for extra in extras for entry in extra)]
    return listed + [entry for group in groups.values() for entry in group if isinstance(entry, str)]


def test_tested_versions_fit_what_is_required():
    requirements = pytest.importorskip("packaging.requirements", reason="in the group dev")
    pinned = dict(re.findall(r"^([\w.-]+)==(\S+)", CONSTRAINTS, flags=re.MULTILINE))
    assert len(direct_requirements()) > 30
    for line in direct_requirements():
        requirement = requirements.Requirement(line)
        assert requirement.name in pinned, f"{line}: write constraints.txt anew with `nox -s constraints`"
        assert requirement.specifier.contains(pinned[requirement.name]), (
            f"{line}, tested with {pinned[requirement.name]}"
        )


def test_tested_versions_name_no_address():
    for line in CONSTRAINTS.splitlines():
        assert re.fullmatch(r"[\w.-]+==[\w.+!-]+( ; [\w .'\"=<>!()]+)?", line), line


def test_hooks_have_the_tested_versions():
    text = (ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8")
    revisions = dict(
        re.findall(r"repo: https://github\.com/[\w-]+/([\w-]+)\n\s+rev: v?([\d.]+)$", text, flags=re.MULTILINE)
    )
    for hook, package in (("ruff-pre-commit", "ruff"), ("zizmor-pre-commit", "zizmor"), ("check-jsonschema",) * 2):
        assert f"\n{package}=={revisions[hook]}\n" in CONSTRAINTS, hook


def test_every_task_is_described():
    """CONTRIBUTING.md has a line for each."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    assert len(sessions()) > 8
    assert sessions() == set(re.findall(r"^\| `(\w+)` \|", text, flags=re.MULTILINE))
