# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Pages of one file: templates that escape what they show, a policy for what the page runs."""

import base64
from collections.abc import Mapping
import hashlib
from importlib.resources import files
from typing import Any

from startracker_ros.core.extras import extra

_SHARED = 'startracker_ros.tools.report'


def resource(package: str, name: str) -> str:
    """Return the text of a file of a package."""
    return files(package).joinpath(name).read_text(encoding='utf-8')


def render_page(package: str, globals_: Mapping[str, Any] | None = None, *, script: str = '',
                **values: Any) -> str:
    """
    Return the HTML of page.html.j2 of a package with values, which the template escapes.

    It has the style of all pages and runs the script alone. globals_ are names that macros need
    too. MissingLibraryError without Jinja2.
    """
    with extra('report', 'Jinja2', 'The page'):
        from jinja2 import Environment, FunctionLoader, StrictUndefined
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        loader=FunctionLoader(lambda shared: resource(_SHARED, shared)))
    environment.globals.update(globals_ or {})
    style = resource(_SHARED, 'page.css')
    return environment.from_string(resource(package, 'page.html.j2')).render(
        style=style, script=script, policy=_content_policy(style, script), **values)


def _content_policy(style: str, script: str) -> str:
    """Return the policy by which a browser applies and runs these texts and nothing else."""
    scripts = f"script-src '{_hash(script)}'; " if script else ''
    return (f"default-src 'none'; img-src data:; style-src '{_hash(style)}'; {scripts}"
            f"base-uri 'none'; form-action 'none'")


def _hash(text: str) -> str:
    return 'sha256-' + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
