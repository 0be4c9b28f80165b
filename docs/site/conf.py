"""Settings of Sphinx for the site that `make docs` builds. Neither the build nor a page uses a network."""

import sys
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

sys.path.insert(0, str(Path(__file__).parents[2]))

import jaxvibro
from docs.site import autodoc

project = "jaxvibro"
author = "The jaxvibro authors"
release = version = jaxvibro.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
default_role = "py:obj"  # of single backticks in docstrings

myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # docs.site.autodoc writes signatures
autosummary_generate = False
napoleon_google_docstring = False
napoleon_numpy_docstring = True
napoleon_use_rtype = False

highlight_language = "text"

smartquotes = False  # x'' is a second derivative

html_theme = "furo"
html_static_path = ["style.css"]
html_css_files = ["style.css"]
html_title = f"jaxvibro {release}"
html_math_renderer = "mathml"
html_copy_source = False
html_show_copyright = False
html_theme_options = {"navigation_with_keys": True}
python_use_unqualified_type_names = True
maximum_signature_line_length = 100


def _formula(self, node, block):
    """Write a formula as MathML, which browsers draw without a script or a font."""
    self.body.append(tex2mathml(node.astext(), as_block=block))
    raise nodes.SkipNode


def setup(app):
    """Register the renderer of formulas and the adaptations of autodoc."""
    app.add_html_math_renderer(
        "mathml",
        inline_renderers=(lambda self, node: _formula(self, node, False), None),
        block_renderers=(lambda self, node: _formula(self, node, True), None),
    )
    return autodoc.setup(app)
