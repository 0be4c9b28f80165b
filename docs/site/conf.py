"""Settings of Sphinx for the site that `make docs` builds: nothing is fetched, neither here nor by who reads it."""

import importlib.metadata

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

project = "jaxvibro"
author = "The jaxvibro authors"
release = version = importlib.metadata.version("jaxvibro")

extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
myst_enable_extensions = ["dollarmath"]
myst_fence_as_directive = ["math"]
myst_heading_anchors = 3

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
    """A formula as MathML, which browsers draw by themselves."""
    self.body.append(tex2mathml(node.astext(), as_block=block))
    raise nodes.SkipNode


def setup(app):
    """What Sphinx calls: formulas need no script and no font from elsewhere."""
    app.add_html_math_renderer(
        "mathml",
        inline_renderers=(lambda self, node: _formula(self, node, False), None),
        block_renderers=(lambda self, node: _formula(self, node, True), None),
    )
    return {"parallel_read_safe": True}
