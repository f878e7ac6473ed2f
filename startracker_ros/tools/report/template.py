# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Pages of one file: templates that escape what they show, and a policy for what the page runs.

Charts are vector pictures in the colours of the page, light and dark.
"""

import base64
from collections.abc import Callable
import hashlib
from importlib.resources import files
from io import BytesIO
import re
from typing import Any

from startracker_ros.core.extras import extra, new_figure

_SHARED = 'startracker_ros.tools.report'

_SIZE_IN = 4.6, 2.9
_COLOUR = re.compile(r'--(\w+): light-dark\((#\w{6}), (#\w{6})\);')


def resource(package: str, name: str) -> str:
    """Return the text of a file of a package."""
    return files(package).joinpath(name).read_text(encoding='utf-8')


def template(package: str, name: str, **names: Any) -> Any:
    """Return a template of a package with globals, beside those of all pages; it escapes."""
    with extra('report', 'Jinja2', 'The page'):
        from jinja2 import Environment, FunctionLoader, StrictUndefined
    environment = Environment(
        autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        loader=FunctionLoader(lambda shared: resource(_SHARED, shared)))
    environment.globals.update(names)
    return environment.from_string(resource(package, name))


def content_policy(style: str, script: str = '') -> str:
    """Return the policy by which a browser applies and runs these texts and nothing else."""
    scripts = f"script-src '{_hash(script)}'; " if script else ''
    return (f"default-src 'none'; img-src data:; style-src '{_hash(style)}'; {scripts}"
            f"base-uri 'none'; form-action 'none'")


def _hash(text: str) -> str:
    return 'sha256-' + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def chart(draw: Callable[[Any], object]) -> str:
    """
    Return the URI of a picture of what draw(figure) draws; MissingLibraryError.

    It is so small that its text can be read on a phone.
    """
    with extra('report', 'matplotlib', 'A chart'):
        import matplotlib
    # The colours stand in the style of the pages, and nowhere else.
    colours = {name: (light, dark) for name, light, dark in _COLOUR.findall(
        resource('startracker_ros.tools.report', 'page.css'))}
    ink, faint, rule = (colours[name][0] for name in ('ink', 'faint', 'rule'))
    lines = [colours[f'c{number}'][0] for number in range(5)]
    content = BytesIO()
    with matplotlib.rc_context({
            'svg.fonttype': 'none', 'svg.hashsalt': 'startracker', 'font.size': 10,
            'font.family': 'sans-serif', 'text.color': ink, 'axes.labelcolor': ink,
            'axes.edgecolor': faint, 'xtick.color': faint, 'ytick.color': faint,
            'axes.facecolor': 'none', 'legend.frameon': False, 'legend.fontsize': 9,
            'axes.grid': True, 'grid.color': rule, 'axes.formatter.useoffset': False,
            'axes.prop_cycle': f'cycler("color", {lines})'}):
        figure = new_figure(figsize=_SIZE_IN)
        figure.patch.set_alpha(0)
        draw(figure)
        figure.savefig(content, format='svg', metadata={'Date': None})
    return 'data:image/svg+xml;base64,' + base64.b64encode(
        _with_both_colours(content.getvalue().decode(), colours).encode()).decode()


def _with_both_colours(picture: str, colours: dict[str, tuple[str, str]]) -> str:
    """Return an SVG whose colours are those that the reader prefers."""
    for name, (light, _) in colours.items():
        picture = picture.replace(light, f'var(--{name})')
    light, dark = (':root{' + ''.join(
        f'--{name}:{pair[which]};' for name, pair in colours.items()) + '}' for which in (0, 1))
    style = f'{light}@media (prefers-color-scheme:dark){{{dark}}}'
    return re.sub('(<svg [^>]*>)', rf'\1<style>{style}</style>', picture, count=1)
