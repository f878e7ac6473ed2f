# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The native core gives the outputs of the corpus, in C and by ctypes, sanitized and not."""

import json
import shutil
import subprocess
import zlib

import cv2
from golden_vectors import (
    camera_of, damaged, difference, FOLDER, is_accepted, plain, sky_file, STAGES)
from hypothesis import given, settings, strategies as st
from limits import HANGS_S
from native_core import build_module, built, call, compiler, filled
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import chdtri
from startracker_ros.core.camera.distortion import MODELS
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.core.native import aligned
from startracker_ros.core.native import CAMERA, SKY

NAMES = list(MODELS)


def struct_of(camera: Camera) -> np.ndarray:
    """Return the st_camera of a camera."""
    return struct(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy,
                  camera.distortion, camera.distortion_model)


def struct(width, height, fx, fy, cx, cy, distortion, model) -> np.ndarray:
    terms = np.zeros(8)
    terms[:len(distortion)] = distortion
    return np.array((width, height, fx, fy, cx, cy, terms, NAMES.index(model), 0), CAMERA)


def of_list(name: str, camera: np.ndarray, values: np.ndarray, shape: tuple[int, ...]
            ) -> np.ndarray:
    """Return what a function of a camera and a list makes of each row."""
    found = np.empty((len(values), *shape))
    assert call(name, camera, values, found, len(values)) == 0
    return found


# --- the corpus by ctypes ---

def camera_outputs(values):
    camera, pixel = struct_of(camera_of(values)), np.array(values['pixel'], float)
    direction = of_list('st_unproject', camera, pixel, (3,))
    return {'direction': direction, 'projected_pixel': of_list('st_project', camera, direction,
                                                               (2,)),
            'flow_px_rad': of_list('st_image_flow', camera, direction, (2, 3)),
            'shown': [call('stt_shows', camera, uv) == 1 for uv in pixel],
            'quaternion_of_middle': filled('stt_middle_axes', (4,), camera),
            'corner_angle_rad': call('stt_corner_angle', camera)}


def rotation_outputs(values):
    value = {name: np.array(item, float) for name, item in values.items()}
    q, vector, z = value['quaternion'], value['rotation_vector_rad'], value['axis_z']
    step = filled('stt_quaternion_from_rotation_vector', (4,), vector)
    after, matrix = filled('stt_turned', (4,), q, vector), filled(
        'stt_matrix_from_quaternion', (3, 3), q)
    return {
        'quaternion_of_vector': step, 'quaternion_product': filled('stt_multiply', (4,), q, step),
        'quaternion_turned': after,
        'vector_of_quaternion': filled('stt_rotation_vector_from_quaternion', (3,), step),
        'attitude_error_rad': filled('stt_attitude_error', (3,), after, q), 'matrix': matrix,
        'quaternion_of_matrix': filled('stt_quaternion_from_matrix', (4,), filled(
            'stt_matrix_from_quaternion', (3, 3), after)),
        'matrix_turned': filled('stt_turn_matrix', (3, 3), matrix, value['rodrigues']),
        'quaternion_of_axes': filled('stt_quaternion_from_axes', (4,), z, value['towards_y']),
        'matrix_of_vector': filled('stt_matrix_from_rotation_vector', (3, 3), vector),
        'sign_continuous': filled('stt_sign_continuous', (4,), after, -q),
        'sensor_direction': filled('stt_sensor_direction', (3,), matrix, z),
        'angle_rad': call('stt_angle_between', z, value['near_z']),
        'covariance_icrf': filled('stt_covariance_icrf', (3, 3), q, value['covariance_sensor'])}


def linear_algebra_outputs(values):
    A, right = np.array(values['symmetric'], float), np.array(values['right'], float)
    size = len(A)
    lower, solution = np.empty_like(A), np.empty_like(right)
    assert call('stt_cholesky', size, A, right, lower, solution) == 1
    return {
        'determinant_3': call('stt_determinant', size, A),
        'inverse_3': filled('stt_inverse', (3, 3), size, A), 'cholesky': lower,
        'solution': solution,
        'indefinite': [not call('stt_is_positive_definite', size, matrix)
                       for matrix in (A, A - 2 * A[0, 0] * np.eye(size))],
        'gate': [call('stt_gate', probability, dof) for probability in values['probability']
                 for dof in values['dof']]}


def sky_outputs(values):
    content = sky_file(values['sections'])
    file = aligned(len(content))
    file[:] = content
    sky, square = np.array((file.ctypes.data, len(file)), SKY), np.empty(1)
    axis, moved_au = np.array(values['axis']), np.array(values['moved_au'])
    index, pairs, direction = np.empty(64, np.int32), np.empty((2, 2), np.int32), np.empty(3)
    found = call('stt_stars_in_cone', sky, axis, values['radius_rad'], index, len(index))
    for bright, limits in enumerate(pairs):
        call('stt_pairs_between', sky, bright, *values['separation_rad'], limits)
    call('stt_direction_at', sky, values['star'], values['years'], moved_au, direction)
    return {'bytes': len(content), 'checksum': zlib.crc32(content[16:]),
            'stars_in_cone': index[:found], 'pairs_between': pairs.ravel(),
            'nearest_pattern_star': call('stt_nearest_star', sky, axis, 2.0, square),
            'direction': direction,
            'accepted': [is_accepted(damaged(content, *one)) for one in values['damage']]}


NATIVE = {'camera': camera_outputs, 'rotation': rotation_outputs,
          'linear_algebra': linear_algebra_outputs, 'sky': sky_outputs}
CASES = [(name, case) for name in NATIVE
         for case in json.loads((FOLDER / f'{name}.json').read_text())['cases']]


@pytest.mark.parametrize('name, case', CASES,
                         ids=[f'{name}-{case["name"]}' for name, case in CASES])
def test_outputs_by_ctypes(name, case):
    found, expected = plain(NATIVE[name](case['input'])), case['output']
    assert set(found) == set(expected)
    tolerance = STAGES[name].tolerance
    over = {key: difference(key, expected[key], found[key], tolerance[key]) for key in expected}
    assert max(over.values()) <= 1, over


# --- the runner in C ---

def run(name, *arguments, sanitized=False):
    program = built(build_module().runner(name, compiler(), sanitized=sanitized),
                    f'{name}{"-sanitized" * sanitized}')
    return subprocess.run([program, *map(str, arguments)], capture_output=True, text=True,
                          timeout=HANGS_S)


@pytest.mark.parametrize('sanitized', [False, True], ids=['plain', 'sanitized'])
@pytest.mark.parametrize('name, arguments', [
    ('conformance', [FOLDER]), ('interface', []), ('fuzz', [20_000, 1]),
    ('fuzz_images', [300, 1]),
    # An invalid exposure, which only the calls for frames look at.
    ('fuzz_images', [1, 2_000_001_376]),
    ('fuzz_sky', [FOLDER, 3000, 1]), ('fuzz_tracks', [FOLDER, 300, 1]),
    # One star is left, of which lasting errors may have any effect.
    ('fuzz_tracks', [FOLDER, 1, 413])])
def test_the_runner_finds_nothing(name, arguments, sanitized):
    """Under sanitizers any error of memory, or undefined behaviour, ends the program."""
    done = run(name, *arguments, sanitized=sanitized)
    assert done.returncode == 0, done.stdout + done.stderr
    assert ' 0 differences' in done.stdout or ' 0 failures' in done.stdout


@pytest.mark.long
@pytest.mark.parametrize('seed', [2, 3])
def test_a_million_impossible_inputs(seed):
    for name, *arguments in (('fuzz', 1_000_000), ('fuzz_images', 2000),
                             ('fuzz_sky', FOLDER, 100_000), ('fuzz_tracks', FOLDER, 10_000)):
        done = run(name, *arguments, seed * 10 ** 9, sanitized=True)
        assert done.returncode == 0, done.stdout + done.stderr


def test_sanitizers_end_a_program_with_an_error(tmp_path):
    source = tmp_path / 'overflow.c'
    source.write_text('int main(int count, char **arguments) {\n'
                      '    (void)arguments;\n    return 2147483647 + count == 0;\n}\n')
    sanitized = build_module().runner('conformance', compiler(), sanitized=True)
    program = tmp_path / 'overflow'
    build_module().build(sanitized._replace(sources=(source,)), program, tmp_path, compiler())
    assert subprocess.run([program], timeout=HANGS_S, capture_output=True).returncode != 0


def test_the_runner_names_each_difference(tmp_path):
    shutil.copytree(FOLDER, tmp_path / 'corpus')
    path = tmp_path / 'corpus' / 'rotation.json'
    document = json.loads(path.read_text())
    document['cases'][0]['output']['attitude_error_rad'][2] += 1e-6
    document['cases'][1]['output']['unknown'] = 1.0
    path.write_text(json.dumps(document))
    done = run('conformance', tmp_path / 'corpus')
    assert done.returncode == 1
    assert 'rotation usual: attitude_error_rad differs' in done.stdout
    assert 'rotation zero: 14 of 15 outputs are compared' in done.stdout
    assert 'rotation: 5 cases, 70 outputs, 2 differences' in done.stdout
    path.write_text('{"cases": [')
    done = run('conformance', tmp_path / 'corpus')
    assert done.returncode == 2 and 'rotation.json: expected a value' in done.stderr


# --- what others compute of the corpus ---

def corpus(name):
    return [pytest.param(case['input'], case['output'], id=case['name'])
            for stage, case in CASES if stage == name]


@pytest.mark.parametrize('values, output', corpus('camera'))
def test_pixels_of_the_corpus_are_those_of_opencv(values, output):
    camera, direction = camera_of(values), np.array(output['direction'], float)
    seen = np.isfinite(direction).all(axis=1)
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    project = (cv2.fisheye if camera.model.equidistant else cv2).projectPoints
    pixel, _ = project(direction[seen][:, None], np.zeros(3), np.zeros(3), matrix,
                       np.array(camera.distortion))
    np.testing.assert_allclose(pixel[:, 0], np.array(output['projected_pixel'], float)[seen],
                               atol=1e-8)


@pytest.mark.parametrize('values, output', corpus('camera'))
def test_flows_of_the_corpus_are_differences_of_pixels(values, output):
    camera, step = struct_of(camera_of(values)), 1e-5
    direction = np.array(output['direction'], float)
    flow = np.empty((len(direction), 2, 3))
    for axis, turn in enumerate(np.eye(3) * step):
        # The body turns: directions turn the other way.
        ahead, back = (of_list('st_project', camera, direction @ Rotation.from_rotvec(
            sign * turn).as_matrix(), (2,)) for sign in (1, -1))
        flow[:, :, axis] = (ahead - back) / (2 * step)
    np.testing.assert_allclose(flow, np.array(output['flow_px_rad'], float), rtol=1e-7, atol=1e-4)


@pytest.mark.parametrize('values, output', corpus('rotation'))
def test_rotations_of_the_corpus_are_those_of_scipy(values, output):
    q, step = (Rotation.from_quat(values['quaternion']),
               Rotation.from_rotvec(values['rotation_vector_rad']))
    np.testing.assert_allclose((q * step).as_matrix(), Rotation.from_quat(
        output['quaternion_turned']).as_matrix(), atol=1e-14)
    np.testing.assert_allclose(q.as_matrix(), output['matrix'], atol=1e-14)
    np.testing.assert_allclose(step.as_rotvec(), output['attitude_error_rad'], atol=1e-14)


@pytest.mark.parametrize('values, output', corpus('linear_algebra'))
def test_algebra_of_the_corpus_is_that_of_numpy_and_scipy(values, output):
    block = np.array(values['symmetric'])[:3, :3]
    np.testing.assert_allclose(output['determinant_3'], np.linalg.det(block), rtol=1e-9)
    np.testing.assert_allclose(output['inverse_3'] @ block, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(output['gate'], [
        chdtri(dof, probability) for probability in values['probability']
        for dof in values['dof']], rtol=1e-10)


# --- any camera ---

TERMS = {'plumb_bob': (0.3, 0.1, 0.003, 0.003, 0.02),
         'rational_polynomial': (0.3, 0.1, 0.003, 0.003, 0.02, 0.3, 0.1, 0.02),
         'equidistant': (0.06, 0.01, 0.003, 0.001)}


@given(st.sampled_from(NAMES), st.lists(st.floats(-1, 1), min_size=8, max_size=8),
       st.floats(300, 4000), st.floats(-0.3, 1.3))
@settings(max_examples=150, deadline=None)
def test_any_camera_is_that_of_the_package(model, shares, focal_px, centre):
    terms = tuple(np.multiply(TERMS[model], shares[:len(TERMS[model])]))
    numbers = 640, 480, focal_px, 1.01 * focal_px, 640 * centre, 239.2, terms, model
    possible = call('st_check_camera', struct(*numbers), None) == 0
    try:
        camera = Camera(*numbers)
    except CameraError:
        assert not possible
        return
    assert possible
    rng = np.random.default_rng(1)
    pixel = rng.uniform(-0.5, [639.5, 479.5], (30, 2))
    direction = of_list('st_unproject', struct_of(camera), pixel, (3,))
    np.testing.assert_allclose(direction, camera.unproject(pixel), atol=1e-12)
    again = of_list('st_project', struct_of(camera), direction, (2,))
    np.testing.assert_allclose(again, camera.project(direction), atol=1e-9 * focal_px)
    np.testing.assert_allclose(again[np.isfinite(again)], pixel[np.isfinite(again)], atol=1e-4)
