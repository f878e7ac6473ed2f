# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The whole examination as one result."""

from dataclasses import asdict
from pathlib import Path
import platform

from startracker_ros import __version__
from startracker_ros.io.table import Result
from startracker_ros.tools.doctor.camera import check_camera
from startracker_ros.tools.doctor.dds import check_dds
from startracker_ros.tools.doctor.install import check_install, check_storage


def examine(*, camera_file: Path | None = None, listen_s: float = 0.0,
            namespace: str = '') -> Result:
    """Return one row for each check; a camera is looked at when a file or a time is given."""
    checks = [*check_install(), *check_dds(), *check_storage()]
    if camera_file is not None or listen_s:
        checks += check_camera(camera_file, listen_s, namespace)
    return Result('doctor', [asdict(check) for check in checks], {
        'package': f'startracker_ros {__version__} in {Path(__file__).parents[2]}',
        'machine': f'{platform.system()} {platform.machine()}',
        'result': f'{sum(not check.holds for check in checks)} of {len(checks)} to fix'})
