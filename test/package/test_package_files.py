"""package.xml, setup.py and the list of nodes agree with the code."""

import ast
import importlib
import inspect
from pathlib import Path
import subprocess
import sys

from catkin_pkg.package import parse_package
import startracker_ros
from startracker_ros.executables import EXECUTABLES

SOURCE = Path(__file__).parents[2]


def test_package_xml_is_valid_and_of_the_version_of_the_code():
    warnings = []
    package = parse_package(SOURCE / 'package.xml', warnings=warnings)
    package.validate(warnings)
    assert warnings == []
    assert package.get_build_type() == 'ament_python'
    assert package.version == startracker_ros.__version__


def test_setup_py_and_package_xml_name_the_same_package():
    shown = subprocess.run(
        [sys.executable, 'setup.py', '--name', '--version', '--license', '--maintainer-email'],
        cwd=SOURCE, capture_output=True, text=True, check=True).stdout.split()
    package = parse_package(SOURCE / 'package.xml')
    assert shown == [package.name, package.version, package.licenses[0],
                     package.maintainers[0].email]


def test_every_ros_package_imported_is_a_dependency():
    depends = {depend.name for depend in parse_package(SOURCE / 'package.xml').exec_depends}
    imported = set()
    for file in SOURCE.glob('startracker_ros/**/*.py'):
        for statement in ast.walk(ast.parse(file.read_text())):
            if isinstance(statement, ast.ImportFrom):
                imported.add(statement.module.partition('.')[0])
            elif isinstance(statement, ast.Import):
                imported |= {name.name.partition('.')[0] for name in statement.names}
    ros = {name for name in imported if name.endswith(('_msgs', '_srvs', '_interfaces', 'rclpy'))}
    assert 'rclpy' in ros
    assert ros <= depends


def test_every_node_can_be_called_with_and_without_arguments():
    for module in EXECUTABLES.values():
        signature = inspect.signature(importlib.import_module(module).main)
        signature.bind()
        signature.bind(['--ros-args'])
