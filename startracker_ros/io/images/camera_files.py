# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Camera files: YAML in the format of ROS camera_calibration, or a FITS header."""

from pathlib import Path

from startracker_ros.core.camera.calibrated import calibrated_camera
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.yaml_text import read_yaml
from startracker_ros.io.images.wcs_file import read_wcs_camera, SUFFIXES
from startracker_ros.io.output import write_output
import yaml


def load_camera(path: str | Path) -> Camera:
    """
    Read a camera file.

    Args:
        path: YAML of ROS camera_calibration, or FITS header with TAN, ZPN and SIP.

    Returns:
        `Camera`.

    Raises:
        CameraError: A file that cannot be read, or no such calibration.

    """
    if is_wcs(path):
        return read_wcs_camera(path).camera
    try:
        document = read_yaml(path)
        matrix = [float(value) for value in document['camera_matrix']['data']]
        distortion = [float(value) for value in document['distortion_coefficients']['data']]
        return calibrated_camera(
            int(document['image_width']), int(document['image_height']),
            str(document['distortion_model']), distortion, matrix)
    except OSError as error:
        raise CameraError(f'camera file {path}: {error.strerror}') from error
    except CameraError as error:
        raise CameraError(f'camera file {path}: {error}') from error
    except (KeyError, IndexError, TypeError, ValueError, OverflowError) as error:
        reason = (f'{error.args[0]} is missing' if isinstance(error, KeyError) else
                  str(error) if isinstance(error, ValueError) else
                  'it needs image_width, image_height, camera_matrix, distortion_model and '
                  'distortion_coefficients as YAML')
        raise CameraError(
            f'camera file {path}: not a ROS camera calibration: {reason}') from error


def is_wcs(path: str | Path) -> bool:
    """Return whether a camera file is a FITS header, by its name."""
    return Path(path).suffix.lower() in SUFFIXES


def save_camera(camera: Camera, path: str | Path) -> None:
    """Write a camera as YAML in the format of ROS camera_calibration."""
    matrix = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    document = {
        'image_width': camera.width,
        'image_height': camera.height,
        'camera_name': 'star_tracker',
        'camera_matrix': {'rows': 3, 'cols': 3, 'data': [float(v) for v in matrix]},
        'distortion_model': camera.distortion_model,
        'distortion_coefficients': {
            'rows': 1, 'cols': len(camera.distortion),
            'data': [float(v) for v in camera.distortion]},
        'rectification_matrix': {
            'rows': 3, 'cols': 3, 'data': [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]},
        'projection_matrix': {
            'rows': 3, 'cols': 4,
            'data': [float(v) for v in (*matrix[:3], 0.0, *matrix[3:6], 0.0, *matrix[6:], 0.0)]},
    }
    write_output(path, yaml.safe_dump(document, sort_keys=False, default_flow_style=None))
