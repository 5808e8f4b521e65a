"""Configuration of the documentation site; `make docs` builds it into ``out/site``."""

from __future__ import annotations

import re
from importlib.metadata import version as installed_version
from pathlib import Path

from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[1]

project = "palpate"
author = "The palpate authors"
copyright = author
release = installed_version("palpate")
version = release

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
]
exclude_patterns = [
    "package.md",  # the page for a package index
    "validation/*",
    "images/*",
    "**/.ipynb_checkpoints",
]
templates_path: list[str] = []
html_static_path = ["_static"]
html_css_files = ["palpate.css"]
html_theme = "furo"
html_title = "palpate"
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#8c2f39", "color-brand-content": "#8c2f39"},
    "dark_css_variables": {"color-brand-primary": "#e58a93", "color-brand-content": "#e58a93"},
}

# Notebooks: only pages with notebook front matter run; results are kept between builds.
nb_execution_mode = "cache"
nb_execution_cache_path = str(ROOT / "out" / "site-cache" / "notebooks")
nb_execution_timeout = 600  # [s] of one cell
nb_execution_raise_on_error = True
nb_merge_streams = True

myst_enable_extensions = ["amsmath", "attrs_block", "attrs_inline", "colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 4

# References: docstrings are NumPy style; their types have shapes and units, so signatures need none.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
autodoc_inherit_docstrings = True
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
default_role = "py:obj"
python_display_short_literal_types = True
python_maximum_signature_line_length = 88
add_module_names = False

copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

# MathJax is needed when a page is read, not when it is built.
linkcheck_anchors = False
linkcheck_timeout = 20
linkcheck_retries = 2
linkcheck_ignore = [r"https?://(localhost|127\.0\.0\.1)"]

# Pages that show a file of the repository's root.
ROOT_PAGES = {
    "explanation/architecture": "ARCHITECTURE.md",
    "contributing": "CONTRIBUTING.md",
    "changelog": "CHANGELOG.md",
}


def show_root_file(app: Sphinx, page: str, source: list[str]) -> None:
    """Replace the source of a page of `ROOT_PAGES` by its file, and links to these files by links to the pages."""
    up = "../" * page.count("/")
    if page in ROOT_PAGES:
        text = (ROOT / ROOT_PAGES[page]).read_text(encoding="utf-8")
        text = re.sub(r"\]\(docs/", f"]({up}", text)
        source[0] = re.sub(r"\[([^\]]*)\]\((?!https?:|#)(?:tests|benchmarks|validation|examples|src|page)/[^)]*\)",
                           r"\1", text)  # fmt: skip
    for target, file in ROOT_PAGES.items():
        source[0] = re.sub(rf"\]\((?:\.\./)*{file}(?=[)#])", f"]({up}{target}.md", source[0])


def drop_empty_patterns(app: Sphinx, page: str, source: list[str]) -> None:
    """Drop patterns of the index that match no page yet: Sphinx 9 warns of each and has no setting against it."""
    if page == "index":
        lines = source[0].splitlines(keepends=True)
        pattern = re.compile(r"^[\w/]+\*\n$")
        source[0] = "".join(
            line for line in lines if not pattern.match(line) or any(app.srcdir.glob(f"{line.strip()}.md"))
        )


def setup(app: Sphinx) -> None:
    """Connect what changes the text of pages before it is parsed."""
    app.connect("source-read", show_root_file)
    app.connect("source-read", drop_empty_patterns)
