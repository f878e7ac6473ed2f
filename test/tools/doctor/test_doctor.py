# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Each check tells a sound machine from one to fix, and says how."""

from dataclasses import replace
import json
import os
from pathlib import Path
import subprocess
import sys
import time

from limits import HANGS_S
import pytest
from shifted_bags import GPS_NS
from skies import CAMERA
from startracker_ros.core import native
from startracker_ros.core.camera.model import Camera
from startracker_ros.io.images.camera_files import save_camera
from startracker_ros.ros.executables import EXECUTABLES
from startracker_ros.ros.processes import take_domain
from startracker_ros.tools.doctor import camera, dds, install

ROOT = Path(__file__).parents[3]
J2026_NS = 1_767_225_600 * 10 ** 9


def doctor(*arguments, **environment):
    return subprocess.run(
        [sys.executable, '-m', 'startracker_ros', 'doctor', *arguments], text=True,
        capture_output=True, timeout=HANGS_S,
        env={**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
             'ROS_DOMAIN_ID': take_domain(), **environment})


@pytest.mark.slow
def test_every_check_is_a_row_and_the_status_tells_whether_all_hold(tmp_path):
    save_camera(replace(CAMERA, fy=CAMERA.fx * 1.1), tmp_path / 'camera.yaml')
    done = doctor('--json', '--camera', str(tmp_path / 'camera.yaml'))
    document = json.loads(done.stdout)
    assert done.returncode == 1
    assert set(document) == {'name', 'conditions', 'rows'} and document['name'] == 'doctor'
    rows = {row['check']: row for row in document['rows']}
    assert not rows['camera file: pixels']['holds']
    for sound in ('Python', 'packages', 'native core', 'star catalogue', 'middleware',
                  'ROS_DOMAIN_ID', 'discovery range', 'Fast DDS profile', 'loopback',
                  'camera file: field'):
        assert rows[sound]['holds'], rows[sound]
    assert '2 MiB image in' in rows['loopback']['result']
    assert all(row['holds'] or row['mend'] for row in document['rows'])


def test_the_native_core_is_named_or_what_to_do(monkeypatch):
    row = install.check_native()
    assert row.holds and 'interface 3' in row.result and row.result.endswith('libstartracker.so')
    monkeypatch.setattr(native, 'VERSION', 99)
    native.library.cache_clear()
    row = install.check_native()
    native.library.cache_clear()
    assert not row.holds and row.result.endswith('different versions of startracker.h')
    assert row.mend == native.REMEDY


def test_status_is_0_when_all_hold():
    from startracker_ros.io.table import Result
    from startracker_ros.tools.cli.shared import finish
    from startracker_ros.tools.doctor.install import Check
    good = vars(Check('Python', '3.12.1'))
    finish(Result('doctor', [good]), as_json=True)
    with pytest.raises(SystemExit) as ended:
        finish(Result('doctor', [good, {**good, 'holds': False}]), as_json=True)
    assert ended.value.code == 1


def test_a_middleware_that_is_not_there_is_a_row_not_a_crash():
    check = dds.check_loopback({**os.environ, 'RMW_IMPLEMENTATION': 'rmw_of_nobody'})
    assert not check.holds and 'Traceback' not in check.result


def test_brackets_of_a_text_are_printed():
    assert "'.[ros]'" in subprocess.run(
        [sys.executable, '-c', 'from startracker_ros.io.table import Result, show; '
         'show(Result("x", [{"mend": "pip install \'.[ros]\' :star:"}]), False)'],
        capture_output=True, text=True, cwd=ROOT, timeout=HANGS_S).stdout


def test_broken_and_missing_packages_are_named(tmp_path, monkeypatch):
    (tmp_path / 'broken_package.py').write_text('raise SystemError("built for another NumPy")')
    monkeypatch.syspath_prepend(tmp_path)
    check = install.check_packages(
        [('numpy', 'numpy'), ('broken_package', 'none'), ('no_such_package', 'none')])
    assert not check.holds
    assert 'built for another NumPy' in check.result and 'no_such_package' in check.result


def test_ament_marker_and_executables(tmp_path, monkeypatch):
    assert not next(install.check_ament([str(tmp_path)])).holds
    marker = tmp_path / 'share/ament_index/resource_index/packages/startracker_ros'
    marker.parent.mkdir(parents=True)
    marker.touch()
    found, executables = install.check_ament(['/no/such/prefix', str(tmp_path)])
    assert found.holds and not executables.holds and 'star_tracker' in executables.result
    folder = tmp_path / 'lib/startracker_ros'
    folder.mkdir(parents=True)
    for node in EXECUTABLES:
        (folder / node).write_text('#!/usr/bin/env python3\n')
        (folder / node).chmod(0o755)
    monkeypatch.setenv('PATH', str(Path(sys.executable).parent))
    assert all(check.holds for check in install.check_ament([str(tmp_path)]))
    monkeypatch.setenv('PATH', str(tmp_path))
    assert 'python3 on PATH' in list(install.check_ament([str(tmp_path)]))[1].result


@pytest.mark.parametrize('environment, check, holds', [
    ({}, dds.check_domain, True),
    ({'ROS_DOMAIN_ID': '101'}, dds.check_domain, True),
    ({'ROS_DOMAIN_ID': '102'}, dds.check_domain, False),
    ({'ROS_DOMAIN_ID': 'seven'}, dds.check_domain, False),
    ({'ROS_DOMAIN_ID': '²'}, dds.check_domain, False),
    ({}, dds.check_discovery, True),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}, dds.check_discovery, True),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'}, dds.check_discovery, False),
    ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'localhost'}, dds.check_discovery, False),
    ({}, dds.check_security, True),
    ({'ROS_SECURITY_ENABLE': 'true'}, dds.check_security, False),
    ({'ROS_SECURITY_ENABLE': 'true', 'ROS_SECURITY_KEYSTORE': '/no/such'},
     dds.check_security, False),
])
def test_environment(environment, check, holds):
    found = check(environment)
    assert found.holds == holds
    assert holds or found.mend


def test_profile(tmp_path):
    def of(path):
        return dds.check_profile({'FASTRTPS_DEFAULT_PROFILES_FILE': str(path)}, own=True)
    assert of(ROOT / 'config' / 'fastdds.xml').holds
    assert not of(tmp_path / 'none.xml').holds
    (tmp_path / 'torn.xml').write_text('<dds><profiles>')
    assert not of(tmp_path / 'torn.xml').holds
    (tmp_path / 'small.xml').write_text('<dds><segment_size>524288</segment_size></dds>')
    assert 'too small' in of(tmp_path / 'small.xml').result


def test_shared_memory_of_a_container_is_too_small():
    assert not dds.check_shared_memory(64 * 2 ** 20).holds
    assert dds.check_shared_memory(2 ** 30).holds


def test_caches(tmp_path):
    (tmp_path / 'file').touch()
    assert install.check_cache(tmp_path / 'made' / 'later').holds
    assert not install.check_cache(tmp_path / 'file' / 'below').holds
    assert 'GB free' in install.check_disk(tmp_path).result
    assert not install.check_disk(tmp_path / 'file').holds


@pytest.mark.parametrize('changed, trouble', [
    (CAMERA, ''),
    (Camera.from_fov(1024, 1024, 1.0), 'field'),
    (Camera.from_fov(1024, 1024, 120.0), 'field'),
    (Camera.from_fov(1024, 1024, 180.0, 'equidistant'), ''),
    (replace(CAMERA, fy=CAMERA.fx * 1.1), 'pixels'),
    (replace(CAMERA, cx=200.0), 'principal point'),
])
def test_geometry(changed, trouble):
    wrong = [check for check in camera.check_geometry('camera', changed) if not check.holds]
    assert [check.check for check in wrong] == ([f'camera: {trouble}'] if trouble else [])


def heard_images(**changes):
    return {'count': 3, 'publishers': 1, 'frame_id': 'lens', 'width': 1024, 'height': 1024,
            'encoding': 'mono16', 'error': '', 'best_effort': False, 'median_dn': 70.0,
            'max_dn': 4095, 'brightest_share': 1e-5,
            'stamps_ns': [J2026_NS + index * 10 ** 8 for index in range(3)], **changes}


@pytest.mark.parametrize('changes, trouble', [
    ({}, ''),
    ({'count': 0}, ''),
    ({'encoding': '32FC1', 'error': "image encoding '32FC1' is not one of mono8"}, ': encoding'),
    ({'width': 512}, ': size'),
    ({'frame_id': 'camera'}, ': frame_id'),
    ({'best_effort': True}, ': reliability'),
    ({'max_dn': 70}, ': light'),
    ({'brightest_share': 0.1}, ': light'),
    ({'stamps_ns': [J2026_NS] * 3}, ': rate'),
    ({'stamps_ns': [10 ** 9, 2 * 10 ** 9]}, ': stamp'),
    ({'stamps_ns': [time.time_ns() - GPS_NS + step for step in (0, 10 ** 8)]}, ': stamp'),
])
def test_images(changes, trouble):
    wrong = [check for check in camera.check_images(
        heard_images(**changes), {'frame_id': 'lens'}, CAMERA) if not check.holds]
    expected = [f'image_raw{trouble}'] if changes else []
    assert [check.check for check in wrong] == expected
    assert all(check.mend for check in wrong)


def test_rate_is_that_of_the_stamps():
    rates = [check for check in camera.check_images(heard_images(), {'frame_id': 'lens'}, CAMERA)
             if check.check == 'image_raw: rate']
    assert rates[0].result.startswith('10.00 Hz')


@pytest.mark.parametrize('heard, trouble', [
    ({'count': 0, 'publishers': 0}, 'camera_info'),
    ({'count': 1, 'error': 'focal length (0.0, 0.0) px must be positive'}, 'camera_info'),
])
def test_camera_info_without_a_camera(heard, trouble):
    check, = camera.check_info(heard, None)
    assert check.check == trouble and not check.holds and check.mend


def test_camera_file_that_is_invalid_is_one_row(tmp_path):
    (tmp_path / 'camera.yaml').write_text('nothing')
    check, = camera.check_camera(tmp_path / 'camera.yaml', 0.0)
    assert not check.holds and 'camera.yaml' in check.result
