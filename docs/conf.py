"""Configuration of the documentation site. `docs/README.md` says how it is built."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
sys.path[:0] = [str(HERE / "_extensions"), str(ROOT)]

import api_pages  # noqa: E402
import catalogue  # noqa: E402
import freshness  # noqa: E402
import matplotlib  # noqa: E402
import pictures  # noqa: E402
import recorded  # noqa: E402

import pymc_backbone  # noqa: E402

matplotlib.rcParams["svg.hashsalt"] = "pymc-backbone"  # the same picture has the same bytes

project = "pymc-backbone"
author = "The pymc-backbone developers"
copyright = author
release = pymc_backbone.__version__
version = release

# Made here, before Sphinx reads anything, and not kept in the repository (docs/README.md).
catalogue.write(HERE / "reference" / "effects")
pictures.write(HERE / "figures")
api_pages.write(HERE / "reference" / "api")
recorded.record(HERE / "recorded", HERE / "_cache")
(HERE / "examples").mkdir(exist_ok=True)
for notebook in sorted((ROOT / "examples" / "notebooks").glob("*.ipynb")):
    copy = HERE / "examples" / notebook.name
    if not copy.exists() or copy.read_bytes() != notebook.read_bytes():
        shutil.copyfile(notebook, copy)

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_design",
    "offline_math",
]
source_suffix = {".rst": "restructuredtext", ".md": "myst-nb", ".ipynb": "myst-nb"}
exclude_patterns = ["_build", "_cache", "_extensions", "README.md", "**/.ipynb_checkpoints"]

# Text
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist", "attrs_inline"]
myst_heading_anchors = 3
html_math_renderer = "offline"
default_role = "py:obj"
smartquotes = False  # x'' is a derivative

# Notebooks. The pages of the how-to part run with every build; the notebooks in examples/ carry their outputs, which
# the tests run and compare, and run here when asked to.
_sources = [path for path in (ROOT / "pymc_backbone").rglob("*.py")]
nb_execution_mode = "cache"
nb_execution_cache_path = str(freshness.newest_or(HERE / "_cache", "notebooks", freshness.digest(_sources, ROOT)))
nb_execution_timeout = 900
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True
if not os.environ.get("PYMC_BACKBONE_SITE_EXECUTE"):
    nb_execution_excludepatterns = ["examples/*"]
os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))

# Reference
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings give types with shapes and units
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_param = False  # types hold shapes in words, which would be linked to whatever has that name
napoleon_use_rtype = False
napoleon_custom_sections = [("Attributes", "params_style")]  # one entry may name several attributes

# Look
html_theme = "furo"
html_title = f"pymc-backbone {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#00558c", "color-brand-content": "#00558c"},
    "dark_css_variables": {"color-brand-primary": "#6cb6e6", "color-brand-content": "#6cb6e6"},
    "navigation_with_keys": False,
}
