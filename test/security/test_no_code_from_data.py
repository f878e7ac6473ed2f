# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Nothing that is read can run: neither as Python, nor through a shell, nor by its size."""

import ast
from pathlib import Path
import sys

import pytest
from startracker_ros.core.camera.model import CameraError
from startracker_ros.io.images.camera_files import load_camera
from startracker_ros.io.images.images import ImageError, read_image
from startracker_ros.ros.messages.message_types import message_class

ROOT = Path(__file__).parents[2]
SOURCES = sorted([*ROOT.glob('startracker_ros/**/*.py'), *ROOT.glob('launch/*.py'),
                  *ROOT.glob('evaluation/startracker_evaluation/**/*.py')])
UNSAFE_MODULES = {'pickle', 'cPickle', 'dill', 'cloudpickle', 'joblib', 'marshal', 'shelve'}
UNSAFE_CALLS = {
    'eval', 'exec', 'compile', '__import__', 'os.system', 'os.popen', 'subprocess.getoutput',
    'subprocess.getstatusoutput', 'yaml.full_load', 'yaml.unsafe_load', 'yaml.load_all',
    'yaml.full_load_all', 'yaml.unsafe_load_all', 'pandas.read_pickle'}
SAFE_LOADERS = {'yaml.SafeLoader', 'yaml.CSafeLoader'}
# Modules named by a table in the code or, in message_types.py, by data that is checked below.
MAY_IMPORT_BY_NAME = {
    'ros/messages/message_types.py', 'ros/node.py', 'tools/doctor/install.py',
    'startracker_evaluation/bench/centroid.py', 'startracker_evaluation/cli/measurement.py',
    'startracker_evaluation/bench/jpda.py',
    # Names of the package.
    '__init__.py',
    # Names in the package of the classes that are registered.
    'core/registry.py'}


def unsafe(source: str) -> list[str]:
    """Return what a source does that could run data, with line numbers."""
    found = []
    for node in ast.walk(ast.parse(source)):
        names = []
        if isinstance(node, ast.Import):
            names = [name.name for name in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or '']
        found += [f'{node.lineno}: import {name}' for name in names
                  if name.partition('.')[0] in UNSAFE_MODULES]
        if not isinstance(node, ast.Call):
            continue
        called = ast.unparse(node.func)
        keywords = {word.arg: ast.unparse(word.value) for word in node.keywords}
        if (called in UNSAFE_CALLS
                or (called == 'yaml.load' and keywords.get('Loader') not in SAFE_LOADERS)
                or keywords.get('shell', 'False') != 'False'
                or keywords.get('allow_pickle', 'False') != 'False'):
            found.append(f'{node.lineno}: {ast.unparse(node)}')
    return found


@pytest.mark.parametrize('source', [
    'import pickle', 'from pickle import loads', 'import numpy.x, dill', 'eval(text)',
    'exec(text)', 'yaml.load(text)', 'yaml.load(text, Loader=yaml.Loader)',
    'yaml.unsafe_load(text)', 'subprocess.run(text, shell=True)', 'os.system(text)',
    'np.load(path, allow_pickle=True)', 'np.load(path, allow_pickle=wanted)'])
def test_the_search_finds(source):
    assert unsafe(source)


def test_the_search_lets_pass():
    assert not unsafe('yaml.safe_load(a); yaml.load(a, Loader=yaml.CSafeLoader); re.compile(a); '
                      'np.load(a, allow_pickle=False); subprocess.run([a])')


def test_no_source_runs_data():
    assert len(SOURCES) > 100
    found = {str(path.relative_to(ROOT)): unsafe(path.read_text()) for path in SOURCES}
    assert {path: lines for path, lines in found.items() if lines} == {}


def test_modules_are_imported_by_name_only_where_it_is_reviewed():
    importing = {path.relative_to(ROOT / path.relative_to(ROOT).parts[0]).as_posix()
                 for path in SOURCES if 'import_module(' in path.read_text()}
    assert importing <= MAY_IMPORT_BY_NAME


@pytest.mark.parametrize('name', [
    'antigravity/msg/X', 'this/msg/This', 'os/msg/Path', 'evil_package/msg/Image',
    '../evil_package/msg/Image', 'sensor_msgs/msg/../Image', 'sensor_msgs/msg/__doc__',
    'sensor_msgs/msg/NoSuch', 'sensor_msgs/Image', 'Image', '', 'a/b/c/d',
    'sensor_msgs.msg/msg/X'])
def test_a_type_name_out_of_a_bag_imports_no_other_module(name, tmp_path, monkeypatch):
    package = tmp_path / 'evil_package'
    (package / 'msg').mkdir(parents=True)
    (package / '__init__.py').write_text('raise SystemExit("imported")')
    (package / 'msg' / '__init__.py').write_text('class Image: pass')
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)
    with pytest.raises(ImportError):
        message_class(name)
    assert not {'antigravity', 'this', 'evil_package'} & (set(sys.modules) - before)


def test_installed_messages_are_found():
    assert message_class('sensor_msgs/msg/Image').__name__ == 'Image'


@pytest.mark.parametrize('text', [
    '[' * 5000, '!!python/object/apply:os.system ["touch pwned"]', 'a: ' + 'x' * 2_000_000,
    'distortion_model: plumb_bob\ncamera_matrix: {data: [.inf, 0, 0, 0, 1]}\nimage_width: .inf',
    '\x00\x01', 'a: &a [*a]'])
def test_a_hostile_camera_file_is_refused(text, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'camera.yaml').write_text(text)
    with pytest.raises(CameraError):
        load_camera(tmp_path / 'camera.yaml')
    assert not (tmp_path / 'pwned').exists()


def test_files_without_an_end_are_refused(monkeypatch):
    with pytest.raises(CameraError, match='1000000 bytes'):
        load_camera('/dev/zero')
    monkeypatch.setattr('startracker_ros.io.images.images._LARGEST_FILE_BYTES', 2_000_000)
    with pytest.raises(ImageError, match='2 MB'):
        read_image('/dev/zero')
