# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Methods of papers register themselves, and the core names none of them."""

import ast
from dataclasses import replace
from pathlib import Path

import pytest
from skies import CAMERA
from startracker_ros import core
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.identify import methods
from startracker_ros.core.identify.identification import IdentificationOptions, Identifier
from startracker_ros.core.registry import Method, METHODS, MODELS
from startracker_ros.core.track.options import TrackerOptions

CORE = Path(core.__file__).parent
OF_PAPERS = {name for name, registered in METHODS.items()
             if 'core.papers' in registered.where} | MODELS.keys() - {'attitude'}


def test_the_core_names_no_method_of_a_paper():
    named = {f'{path.name}: {node.value}' for path in CORE.rglob('*.py')
             if path.parent.name != 'papers' for node in ast.walk(ast.parse(path.read_text()))
             if isinstance(node, ast.Constant) and node.value in OF_PAPERS}
    assert len(OF_PAPERS) == 7 and not named


@pytest.mark.parametrize(('table', 'options', 'option'), [
    (METHODS, IdentificationOptions, 'method'), (MODELS, TrackerOptions, 'model')])
def test_each_is_a_choice(table, options, option):
    row, = (row for row in options.table() if row.name == option)
    assert row.choices == tuple(table)


def test_each_method_is_a_class():
    assert all(issubclass(registered.load(), Identifier) for registered in METHODS.values())


def test_options_that_models_name_are_options():
    known = {row.name for row in TrackerOptions.table()}
    assert {name for model in MODELS.values() for name in (*model.options, *model.ignored)} < known


def test_the_registration_alone_decides(monkeypatch):
    wide = Camera.from_fov(1024, 768, 155.0, 'equidistant')
    methods.check_field(wide, 'quad')
    monkeypatch.setitem(METHODS, 'quad', replace(METHODS['quad'], in_a_plane=True))
    with pytest.raises(CameraError, match='quad works in a plane'):
        methods.make_identifier(wide, 2026.0, IdentificationOptions(method='quad'))
    assert Method('startracker_ros.core.camera.model:Camera').load() is type(CAMERA)
