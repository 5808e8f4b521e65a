"""Configuration of the documentation site; `make docs` builds it into ``out/site``."""

from __future__ import annotations

import inspect
import os
import re
import sys
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

import latex2mathml.converter
from docutils.nodes import SkipNode
from sphinx.application import Sphinx
from sphinx.domains.python import PyObject
from sphinx.util.inspect import stringify_signature

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs"))
# Tutorials run commands: those of the environment that builds the site, also where it is not activated.
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])

import generated_parts  # noqa: E402
import one_kernel  # noqa: E402

project = "palpate"
author = "The palpate authors"
copyright = author
release = installed_version("palpate")
version = release

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
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

# Notebooks: only pages with notebook front matter run. Results are kept until the cells of a page change; after a
# change of palpate, `make clean docs` runs all of them again.
nb_execution_mode = "cache"
nb_execution_cache_path = str(ROOT / "out" / "site-cache" / "notebooks")
nb_execution_timeout = 600  # [s] of one cell
nb_execution_in_temp = True  # pages write their files into a folder that is removed
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

html_math_renderer = "mathml"  # browsers draw it without a script or a network

linkcheck_anchors = False
linkcheck_timeout = 20
linkcheck_retries = 2
linkcheck_ignore = [
    r"https?://(localhost|127\.0\.0\.1)",
    r"https://doi\.org/",  # publishers answer programs with 403
]

# Pages that show a file of the repository's root.
ROOT_PAGES = {
    "explanation/architecture": "ARCHITECTURE.md",
    "contributing": "CONTRIBUTING.md",
    "changelog": "CHANGELOG.md",
}
SITE_ENDS = "<!-- The site shows what stands above. -->"  # in such a file: the repository alone has what follows


def show_root_file(app: Sphinx, page: str, source: list[str]) -> None:
    """Replace the source of a page of `ROOT_PAGES` by its file, and links to these files by links to the pages."""
    up = "../" * page.count("/")
    if page in ROOT_PAGES:
        text, _, more = (ROOT / ROOT_PAGES[page]).read_text(encoding="utf-8").partition(SITE_ENDS)
        if more:
            text += f"Everything else is in `{ROOT_PAGES[page]}` of the repository.\n"
        text = re.sub(r"\]\(docs/", f"]({up}", text)
        source[0] = re.sub(r"\[([^\]]*)\]\((?!https?:|#)(?:tests|benchmarks|validation|examples|src|page)/[^)]*\)",
                           r"\1", text)  # fmt: skip
    for target, file in ROOT_PAGES.items():
        source[0] = re.sub(rf"\]\((?:\.\./)*{file}(?=[)#])", f"]({up}{target}.md", source[0])


def fill_generated_parts(app: Sphinx, page: str, source: list[str]) -> None:
    """Replace the marks of a page by what comes of the code."""
    source[0] = generated_parts.fill(source[0])


def show_constructor(
    app: Sphinx, kind: str, name: str, obj: Any, options: Any, signature: str | None, returned: str | None
) -> tuple[str, None] | None:
    """Show the arguments of a class whose metaclass takes any and checks them."""
    if kind == "class" and signature and signature.startswith("(*"):
        if obj.__init__ is object.__init__:  # an abstract class
            return "", None
        constructor = inspect.signature(obj.__init__)
        arguments = [
            each.replace(annotation=inspect.Parameter.empty)
            for each in list(constructor.parameters.values())[1:]  # without self
        ]
        return stringify_signature(inspect.Signature(arguments), show_annotation=False), None
    return None


def keep_colons(app: Sphinx, kind: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Hide the docstrings of properties from napoleon, which takes the words before a colon for a type."""
    if kind in ("attribute", "property") and not any(line.startswith("---") for line in lines):
        property_docs[name] = list(lines)
        lines.clear()


def restore_colons(app: Sphinx, kind: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Restore the docstrings that `keep_colons` has hidden."""
    if name in property_docs:
        lines[:] = property_docs.pop(name)


property_docs: dict[str, list[str]] = {}


def draw_inline_math(translator: Any, node: Any) -> None:
    """Write a formula in a line as MathML."""
    translator.body.append(latex2mathml.converter.convert(node.astext()))
    raise SkipNode


def draw_equation(translator: Any, node: Any) -> None:
    """Write an equation as MathML, with its number in the margin."""
    text = re.sub(r"\\(?:begin|end)\{equation\*\}", "", node.astext())
    number = re.search(r"\\tag\{(.*?)\}", text)
    formula = latex2mathml.converter.convert(re.sub(r"\\tag\{.*?\}", "", text), display="block")
    shown = f'<span class="eqno">({number[1]})</span>' if number else ""
    translator.body.append(f'<div class="equation">{formula}{shown}</div>\n')
    raise SkipNode


def setup(app: Sphinx) -> None:
    """Connect what changes pages and docstrings before they are parsed."""
    one_kernel.use()
    app.add_html_math_renderer("mathml", (draw_inline_math, None), (draw_equation, None))
    app.connect("source-read", show_root_file)
    app.connect("source-read", fill_generated_parts)
    app.connect("autodoc-process-signature", show_constructor)
    app.connect("autodoc-process-docstring", keep_colons, priority=400)  # napoleon has 500
    app.connect("autodoc-process-docstring", restore_colons, priority=600)
    for field in PyObject.doc_field_types:
        if field.name == "variable":
            field.label = "Attributes"
