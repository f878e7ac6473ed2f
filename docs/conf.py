# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Site of the documents: `make docs`, and rosdoc2."""

import importlib.metadata

project = 'startracker_ros'
author = 'startracker_ros authors'
release = version = importlib.metadata.version('startracker_ros')

extensions = ['myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.napoleon']
# The workflow of the repository shows the same pages: links are those of its files.
myst_heading_anchors = 4
# $x$, and ```math as GitHub has it.
myst_enable_extensions = ['dollarmath']
myst_dmath_allow_digits = myst_dmath_allow_space = False
myst_fence_as_directive = ['math']
exclude_patterns = ['examples']
html_theme = 'sphinx_rtd_theme'  # that of rosdoc2
html_static_path = ['_static']
html_css_files = ['site.css']
autodoc_member_order = 'bysource'
autodoc_typehints = 'description'
autodoc_typehints_description_target = 'documented'
napoleon_use_ivar = True
# Links to sources leave the site.
suppress_warnings = ['myst.xref_missing']
