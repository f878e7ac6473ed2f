# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Site of the documents: `make docs`, and rosdoc2. What it builds needs no network."""

import importlib.metadata
from importlib.util import find_spec
import re
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import MathError, tex2mathml
from sphinx.application import Sphinx
from sphinx.util.logging import getLogger

project = 'startracker_ros'
author = 'the startracker_ros authors'
project_copyright = f'2026, {author}'
release = version = importlib.metadata.version('startracker_ros')

extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
# The workflow of the repository shows the same pages: links are those of its files.
myst_heading_anchors = 4
# $x$, and ```math as GitHub has it.
myst_enable_extensions = ['dollarmath']
myst_dmath_allow_digits = myst_dmath_allow_space = False
myst_fence_as_directive = ['math']
html_math_renderer = 'mathml'
exclude_patterns = ['examples']
# The environment of rosdoc2 has this other one.
html_theme = 'furo' if find_spec('furo') else 'sphinx_rtd_theme'
html_title = project
html_static_path = ['_static']
html_css_files = ['site.css']
html_js_files = ['site.js']
# Search finds more.
html_use_index = False
html_copy_source = False
autodoc_member_order = 'bysource'
autodoc_typehints = 'description'
autodoc_typehints_description_target = 'documented'
napoleon_use_ivar = True

_LINK = re.compile(r'\[([^\[\]]*)\]\(([^)\s#:]+)(?:#[^)\s]*)?\)')


def _leave_docs(app: Sphinx, name: str, source: list[str]) -> None:
    """Let links to texts outside of docs be files to read, and those to folders their names."""
    folder = (app.srcdir / name).parent

    def link(found: re.Match[str]) -> str:
        path = (folder / found[2]).resolve()
        if path.is_dir():
            return found[1]
        is_page = path.suffix not in ('.md', '.rst') or path.is_relative_to(app.srcdir)
        return found[0] if is_page else f'[{found[1]}](path:{found[2]})'
    source[0] = _LINK.sub(link, source[0])


def _math(self: Any, node: nodes.Element) -> None:
    """Write an equation as MathML, which browsers draw without a script."""
    block = isinstance(node, nodes.math_block)
    self.body.append(self.starttag(node, 'div' if block else 'span', '', CLASS='math'))
    try:
        self.body.append(tex2mathml(node.astext().strip(), as_block=block))
    except MathError as error:
        getLogger(__name__).warning('%s in %s', error, node.astext(), location=node)
    self.body.append('</div>\n' if block else '</span>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Add what Sphinx calls."""
    app.connect('source-read', _leave_docs)
    app.add_html_math_renderer('mathml', (_math, None), (_math, None))
