# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Inputs and outputs of every stage as JSON, which a port in another language can be tested with.

python test/golden_vectors.py writes test/conformance, whose README has their layout and units.
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
import io
import json
from pathlib import Path
import re
import struct
import sys
import tempfile
from typing import Any, NamedTuple
import zlib

from directions import blurred, field, unit
from native_bank import associate, coordinated_turn, predict, update
from native_core import filled
import numpy as np
from skies import onboard_stars, SMALL_CAMERA, START_NS
import startracker_ros as st
from startracker_ros.core import native
from startracker_ros.core.astro.aberration import (
    Air, apparent_directions, natural_directions, state_near_earth)
from startracker_ros.core.astro.earth import earth_position_au, earth_velocity_m_s
from startracker_ros.core.attitude.attitude_state import AttitudeState
from startracker_ros.core.attitude.estimate import (
    covariance_icrf, cramer_rao, estimate_attitude, SOLVERS)
from startracker_ros.core.attitude.gyro import Gyro
from startracker_ros.core.camera.image_flow import image_jacobian
from startracker_ros.core.catalog.star_file import star_arrays
from startracker_ros.core.centroid.centroids import Centroids, round_errors
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.cache import STARS
from startracker_ros.core.identify.identification import Identification, IdentificationOptions
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.identify.sky_file import sky_arrays
from startracker_ros.core.integrity.protection import protection_level, ProtectionOptions
from startracker_ros.core.integrity.systematic_errors import velocity_covariance
from startracker_ros.core.maths.gates import gate
from startracker_ros.core.maths.rotation import (
    angle_between, ARCSEC, attitude_error, conjugate, matrix_from_quaternion, multiply,
    quaternion_from_axes, quaternion_from_matrix, quaternion_from_rotation_vector, random_attitude,
    rotate, rotation_vector_from_quaternion, sign_continuous, turned)
from startracker_ros.core.native import aligned, check_sky, NativeError
from startracker_ros.core.native_tracker import (
    native_centroids, native_identified, NativeTracker, TRACKS, TRUSTS)
from startracker_ros.core.papers.extended_grid import AttitudePrediction
from startracker_ros.core.registry import MODELS
from startracker_ros.core.stored_arrays import write_arrays
from startracker_ros.core.track.association import DetectionModel
from startracker_ros.core.track.motion_models import constant_velocity

FOLDER = Path(__file__).parent / 'conformance'
EPOCH_YEAR = 2026.5
# A turn about no special axis.
Q = np.array([0.48, -0.36, 0.64, 0.48])

Values = dict[str, Any]
EXACT = (0.0, 0.0)
ROUNDING = (1e-9, 1e-15)


class Stage(NamedTuple):
    """
    A stage: what it does, named inputs, what makes outputs of an input, tolerances by output.

    A tolerance is relative to the largest of the expected values, and absolute.
    """

    does: str
    inputs: Callable[[], Iterator[tuple[str, Values]]]
    outputs: Callable[[Values], Values]
    tolerance: dict[str, tuple[float, float]]


def arrays(values: Values, *names: str) -> list[np.ndarray]:
    """Return values as arrays of float64."""
    return [np.array(values[name], float) for name in names]


# --- camera ---

def camera_inputs() -> Iterator[tuple[str, Values]]:
    pixels = np.random.default_rng(1).uniform(0, [1023, 767], (8, 2))
    for name, model, terms, focal in (
            ('pinhole', 'plumb_bob', (0.0,) * 5, 3900.0),
            ('plumb_bob', 'plumb_bob', (-0.12, 0.05, 0.001, -0.0007, 0.01), 1500.0),
            ('rational_polynomial', 'rational_polynomial',
             (0.11, -0.04, 0.0005, 0.0003, 0.006, 0.2, -0.01, 0.004), 1500.0),
            ('equidistant', 'equidistant', (-0.02, 0.004, -0.001, 0.0002), 500.0),
            # Its image circle ends within the image, beyond the hemisphere: corners show nothing.
            ('image_circle', 'equidistant', (-0.05, -0.01, 0.0, 0.0), 290.0)):
        yield name, {'camera': asdict(st.Camera(1024, 768, focal, focal * 1.001, 511.8, 383.1,
                                                terms, model)),
                     'pixel': pixels if name != 'image_circle' else np.vstack(
                         [pixels, [[511.8, 383.1], [0.0, 0.0], [-0.6, 300.0], [1023.5, -0.5]]])}


def camera_of(values: Values) -> st.Camera:
    return st.Camera(**{**values['camera'], 'distortion': tuple(values['camera']['distortion'])})


def camera_outputs(values: Values) -> Values:
    camera, (pixel,) = camera_of(values), arrays(values, 'pixel')
    direction = camera.unproject(pixel)
    return {'direction': direction, 'projected_pixel': camera.project(direction),
            'flow_px_rad': image_jacobian(camera, direction),
            'shown': camera.contains(pixel).tolist(),
            'quaternion_of_middle': camera.middle_axes,
            'corner_angle_rad': camera.corner_angle_rad}


# --- rotations and small matrices ---

def rotation_inputs() -> Iterator[tuple[str, Values]]:
    rng = np.random.default_rng(2)
    for name, vector in (('usual', [0.3, -0.7, 0.2]), ('zero', [0.0, 0.0, 0.0]),
                         ('tiny', [3e-9, -2e-9, 1e-9]), ('near_half_turn', [0.0, 3.14, 0.0]),
                         ('large', [1.9, 2.1, -1.1])):
        z, towards_y = unit(rng.normal(size=3)), rng.normal(size=3)
        yield name, {'quaternion': random_attitude(rng), 'rotation_vector_rad': vector,
                     'rodrigues': [0.3, -0.02, 0.11], 'axis_z': z, 'towards_y': towards_y,
                     'near_z': unit(z + 1e-7 * towards_y), 'covariance_sensor': spd(rng, 3)}


def rotation_outputs(values: Values) -> Values:
    q, vector, g, z, towards_y, near_z, P = arrays(
        values, 'quaternion', 'rotation_vector_rad', 'rodrigues', 'axis_z', 'towards_y', 'near_z',
        'covariance_sensor')
    step, after, turned_by_g = (
        quaternion_from_rotation_vector(vector), turned(q, vector), matrix_from_quaternion(q))
    across = np.cross(np.eye(3), g)
    turned_by_g = turned_by_g @ (np.eye(3) + 2 / (1 + g @ g) * (across + across @ across))
    return {'quaternion_of_vector': step, 'quaternion_product': multiply(q, step),
            'quaternion_turned': after, 'vector_of_quaternion': rotation_vector_from_quaternion(
                step), 'attitude_error_rad': attitude_error(after, q),
            'matrix': matrix_from_quaternion(q), 'matrix_of_vector': matrix_from_quaternion(step),
            # Not named a quaternion, of which the sign would not count.
            'sign_continuous': sign_continuous(after, -q),
            'sensor_direction': rotate(conjugate(q), z),
            'quaternion_of_matrix': quaternion_from_matrix(matrix_from_quaternion(after)),
            'matrix_turned': turned_by_g, 'quaternion_of_axes': quaternion_from_axes(z, towards_y),
            'angle_rad': float(angle_between(z, near_z)),
            'covariance_icrf': covariance_icrf(q, P)}


def spd(rng: np.random.Generator, size: int) -> np.ndarray:
    """Return a positive definite matrix (size, size) of elements of other magnitudes."""
    scale = 10.0 ** rng.uniform(-4, 1, size)
    root = rng.normal(size=(size, size + 2)) * scale[:, None]
    matrix: np.ndarray = root @ root.T
    return matrix


def algebra_inputs() -> Iterator[tuple[str, Values]]:
    rng = np.random.default_rng(4)
    for size in (3, 6, 9):
        yield f'{size}_by_{size}', {
            'symmetric': spd(rng, size), 'right': rng.normal(size=(size, 2)),
            'probability': [0.3, 1e-3, 1e-5, 1e-12], 'dof': [1.0, 3.0, 6.5, 200.0]}


def algebra_outputs(values: Values) -> Values:
    symmetric, right = arrays(values, 'symmetric', 'right')
    block = symmetric[:3, :3]
    return {'determinant_3': np.linalg.det(block), 'inverse_3': np.linalg.inv(block),
            'cholesky': np.linalg.cholesky(symmetric), 'solution': np.linalg.solve(
                symmetric, right),
            'indefinite': [bool(np.linalg.eigvalsh(one)[0] <= 0) for one in (
                block, block - 2 * symmetric[0, 0] * np.eye(3))],
            'gate': [gate(p, dof) for p in values['probability'] for dof in values['dof']]}


# --- sky file ---

# Changed byte and mask, bytes cut off, whether the header is corrected: nothing; what the file is,
# the byte order, checksum, layout, number and a name of sections, version; the end.
_DAMAGE = [[0, 0, 0, 1], [0, 1, 0, 1], [8, 5, 0, 1], [12, 1, 0, 0], [24, 3, 0, 1], [31, 1, 0, 1],
           [64, 32, 0, 1], [0, 0, 64, 0], [0, 0, 64, 1]]


def sky_inputs() -> Iterator[tuple[str, Values]]:
    arrays = sky_arrays(st.Camera.from_fov(512, 512, 60.0), 2026.0,
                        IdentificationOptions(magnitude_limit=1.5))
    # Short enough to be read: of the stars of all magnitudes those of the pairs alone.
    count = len(arrays['pattern_member'])
    arrays.update({name: arrays[name][:count] for name in STARS},
                  **{name: arrays[f'pattern_{name}'] for name in ('cells', 'start', 'member')})
    version = 64 + 64 * len(arrays)
    yield 'brightest_stars', {
        'sections': {name: {'type': array.dtype.str[1:], 'shape': array.shape, 'values': array}
                     for name, array in arrays.items()},
        'axis': unit(np.array([-0.2, 1.0, 0.1])), 'radius_rad': 0.6,
        'separation_rad': [0.3, 0.4], 'star': 0, 'years': 0.4, 'moved_au': [1.2, -0.7, -0.3],
        'damage': [*_DAMAGE, [version, 3, 0, 1]]}


def sky_file(sections: Values) -> bytearray:
    """Return the sky file of sections."""
    file = io.BytesIO()
    write_arrays(file, {
        name: np.array(one['values'], one['type']).reshape(one['shape'])
        for name, one in sections.items()})
    return bytearray(file.getvalue())


def damaged(file: bytearray, place: int, mask: int, cut: int, corrected: int) -> bytes:
    """Return a sky file with a byte changed, its end cut off, and the header corrected."""
    copy = file[:len(file) - cut]
    copy[place] ^= mask
    if corrected:
        struct.pack_into('=Q', copy, 16, len(copy))
        struct.pack_into('=I', copy, 12, zlib.crc32(copy[16:]))
    return bytes(copy)


def is_accepted(file: bytes) -> bool:
    with tempfile.NamedTemporaryFile() as opened:
        opened.write(file)
        opened.flush()
        try:
            check_sky(Path(opened.name))
        except NativeError:
            return False
    return True


def sky_outputs(values: Values) -> Values:
    file = sky_file(values['sections'])
    section = {name: np.array(one['values']) for name, one in values['sections'].items()}
    axis, moved_au = arrays(values, 'axis', 'moved_au')
    cosine = section['direction'] @ axis
    star = values['star']
    moved = (section['direction'][star] + values['years'] * section['motion'][star]
             - section['parallax_rad'][star] * moved_au)
    return {
        'bytes': len(file), 'checksum': zlib.crc32(file[16:]),
        'stars_in_cone': np.flatnonzero(cosine >= np.cos(values['radius_rad'])),
        'nearest_pattern_star': cosine[:len(section['pattern_member'])].argmax(),
        'pairs_between': [np.searchsorted(section[f'{part}_separation'], limit, side)
                          for part in ('pair', 'bright')
                          for limit, side in zip(values['separation_rad'], ('left', 'right'))],
        'direction': unit(moved),
        'accepted': [is_accepted(damaged(file, *one)) for one in values['damage']]}


# --- catalogue and apparent places ---

def places_inputs() -> Iterator[tuple[str, Values]]:
    # Sirius, Vega, alpha Centauri A, 61 Cygni A, Groombridge 1830, Polaris.
    hip = [32349, 91262, 71683, 104214, 57939, 11767]
    for name, year, velocity, air in (
            ('centre_of_the_earth', 2026.5, [0.0, 0.0, 0.0], None),
            ('low_orbit', 2031.25, [5100.0, -4700.0, 2900.0], None),
            ('ground', 2019.57, [-300.0, 210.0, 0.0],
             {'zenith': unit(np.array([0.5, -0.4, 0.3])), 'a_rad': 2.9e-4, 'b_rad': -3.2e-7})):
        yield name, {'epoch_year': year, 'geocentric_velocity_m_s': velocity, 'air': air,
                     'hip': hip}


def places_outputs(values: Values) -> Values:
    year, catalog = values['epoch_year'], st.load_catalog()
    row = [int(np.flatnonzero(catalog.hip == hip)[0]) for hip in values['hip']]
    natural = catalog.directions(year, earth_position_au(year))[row]
    state = state_near_earth(year, *arrays(values, 'geocentric_velocity_m_s'))
    if values['air']:
        air = values['air']
        state = state._replace(air=Air(np.array(air['zenith']), air['a_rad'], air['b_rad']))
    apparent = apparent_directions(natural, state)
    return {'earth_velocity_m_s': earth_velocity_m_s(year),
            'heliocentric_au': state.heliocentric_au, 'natural_direction': natural,
            'apparent_direction': apparent,
            'natural_again': natural_directions(apparent, state)}


# --- extraction ---

def extraction_inputs() -> Iterator[tuple[str, Values]]:
    camera, rng = st.Camera.from_fov(96, 80, 6.0), np.random.default_rng(3)
    uv = np.array([[14.3, 12.8], [70.6, 17.1], [41.2, 33.4], [17.9, 60.5], [80.4, 52.7],
                   [52.0, 66.3]])
    expected = 30.0 + star_images(camera, uv, 3000.0 * 0.7 ** np.arange(6), 0.9)
    image = rng.poisson(expected) + rng.normal(0, 3, expected.shape)
    yield 'six_stars', {'image': np.round(image).astype(int)}
    yield 'no_stars', {'image': np.round(rng.normal(100, 5, (24, 32))).astype(int)}


def star_images(camera: st.Camera, uv: np.ndarray, flux: np.ndarray, sigma_px: float
                ) -> np.ndarray:
    """Return the expected flux (H, W) of stars, as psf.py has it."""
    from scipy.stats import norm
    image = np.zeros((camera.height, camera.width))
    for (u, v), f in zip(uv, flux):
        a, d = (np.diff(norm.cdf(np.arange(-0.5, count), centre, sigma_px))
                for centre, count in ((u, camera.width), (v, camera.height)))
        image += f * np.outer(d, a)
    return image


def extraction_outputs(values: Values) -> Values:
    found = st.extract(np.array(values['image'], np.uint16))
    return {'status': found.status, 'uv': found.centroids.uv, 'flux': found.centroids.flux,
            'snr': found.centroids.snr, 'sigma_px': found.centroids.sigma_px,
            'background_dn': found.background_dn, 'noise_dn': found.noise_dn,
            'psf_sigma_px': found.psf_sigma_px}


# --- identification ---

METHODS = {'pyramid': (512, 12.0, 6.0), 'quad': (1024, 20.3, 5.5),
           'hausdorff_pivot': (512, 12.0, 6.0), 'hausdorff_segment': (512, 12.0, 6.0),
           'extended_grid': (1024, 4.0, 8.0)}
"""Side in px, field in deg and magnitude limit."""


def identification_inputs() -> Iterator[tuple[str, Values]]:
    for method, (side_px, fov_deg, limit) in METHODS.items():
        camera, rng = st.Camera.from_fov(side_px, side_px, fov_deg), np.random.default_rng(7)
        onboard, false = onboard_stars(camera, EPOCH_YEAR, limit), 0 if limit > 7 else 2
        centroids, _ = star_list(
            onboard, camera, Q, 0.2, rng, magnitude_sigma=0.05, false=false)
        prior = None
        if method == 'extended_grid':
            centroids = centroids.select(slice(3))
            error = np.array([3.0, -4.0, 20.0]) * ARCSEC
            prior = {'quaternion': multiply(Q, quaternion_from_rotation_vector(error)),
                     'covariance_sensor': np.diag([5.0, 5.0, 30.0]) ** 2 * ARCSEC ** 2}
        yield method, {'method': method, 'camera': asdict(camera), 'epoch_year': EPOCH_YEAR,
                       'magnitude_limit': limit, **list_of(centroids), 'prior': prior}
    yield 'false_stars_alone', {
        'method': 'pyramid', 'camera': asdict(SMALL_CAMERA),
        'epoch_year': EPOCH_YEAR, 'magnitude_limit': 6.0, 'prior': None,
        **list_of(Centroids(np.random.default_rng(8).uniform(0, 511, (9, 2)),
                            np.linspace(2e4, 1e3, 9), np.full(9, 20.0), np.full(9, 0.2)))}


def list_of(centroids: Centroids) -> Values:
    return {'uv': np.round(centroids.uv, 4), 'flux': np.round(centroids.flux, 1),
            'snr': centroids.snr, 'sigma_px': centroids.sigma_px}


def centroids_of(values: Values) -> Centroids:
    return Centroids(*arrays(values, 'uv', 'flux', 'snr', 'sigma_px'))


def identification_outputs(values: Values) -> Values:
    identifier = make_identifier(camera_of(values), values['epoch_year'], IdentificationOptions(
        method=values['method'], magnitude_limit=values['magnitude_limit'], time_limit_s=600.0))
    prior = values['prior']
    given = () if prior is None else (
        AttitudePrediction(*arrays(prior, 'quaternion', 'covariance_sensor')),)
    return identified(identifier.identify(centroids_of(values), *given))


def identified(result: Identification) -> Values:
    attitude = result.attitude
    return {'status': result.status, 'hip': result.hip,
            'quaternion': None if attitude is None else attitude.quaternion,
            'covariance_sensor': None if attitude is None else attitude.covariance_sensor,
            'residual_px': result.residual_px, 'focal_ratio': result.focal_ratio}


# --- attitude ---

def attitude_inputs() -> Iterator[tuple[str, Values]]:
    for count, half_angle_rad in ((2, 0.1), (12, 0.1), (7, 0.9)):
        rng = np.random.default_rng(count)
        true = field(rng, count, half_angle_rad)
        sigma_rad = rng.uniform(2, 20, count) * ARCSEC
        sensor, icrf = blurred(true, sigma_rad, rng), rotate(Q, true)
        for solver in SOLVERS:
            yield f'{solver}_{count}_stars', {'solver': solver, 'sensor': sensor, 'icrf': icrf,
                                              'sigma_rad': sigma_rad}


def attitude_outputs(values: Values) -> Values:
    sensor, icrf, sigma_rad = arrays(values, 'sensor', 'icrf', 'sigma_rad')
    found = estimate_attitude(sensor, icrf, sigma_rad, values['solver'])
    return {'quaternion': found.quaternion, 'covariance_sensor': found.covariance_sensor,
            'covariance_icrf': covariance_icrf(found.quaternion, found.covariance_sensor),
            'residual_rad': found.residual_rad, 'chi2': found.chi2}


# --- protection level ---

def protection_inputs() -> Iterator[tuple[str, Values]]:
    for count, rejected in ((15, 0), (6, 1), (2, 0)):
        rng = np.random.default_rng(count)
        sensor, sigma_rad = field(rng, count), rng.uniform(2, 20, count) * ARCSEC
        yield f'{count}_stars_{rejected}_rejected', {
            'sensor': sensor, 'sigma_rad': sigma_rad, 'rejected': rejected,
            'residual_rad': np.abs(rng.normal(0, sigma_rad)), **asdict(ProtectionOptions()),
            'covariance_sensor': cramer_rao(sensor, sigma_rad),
            'velocity_sigma_m_s': 50.0, 'lens_sigma_rad': 0.5 * ARCSEC, 'lens_scale': 2e-6}


def protection_outputs(values: Values) -> Values:
    sensor, sigma_rad, residual_rad, covariance = arrays(
        values, 'sensor', 'sigma_rad', 'residual_rad', 'covariance_sensor')
    options = ProtectionOptions(values['misleading_probability'],
                                values['false_star_probability'])
    return {'protection_rad': protection_level(covariance, sensor, sigma_rad, residual_rad,
                                               options, values['rejected']),
            'velocity_covariance': velocity_covariance(
                values['velocity_sigma_m_s'], sensor, sigma_rad),
            'lens_covariance': filled(
                'stt_lens_covariance', (3, 3), values['lens_sigma_rad'], values['lens_scale'],
                sensor, sigma_rad, len(sensor))}


# --- association ---

def association_inputs() -> Iterator[tuple[str, Values]]:
    for name, tracks, spacing_px, false in (
            ('apart', 4, 60.0, 2), ('close', 5, 3.0, 3), ('no_centroid', 2, 60.0, None)):
        rng = np.random.default_rng(tracks)
        predicted = 100 + spacing_px * rng.uniform(-1, 1, (tracks, 2))
        root = rng.normal(0, 0.7, (tracks, 2, 2))
        covariance = root @ root.transpose(0, 2, 1) + 0.3 * np.eye(2)
        uv = np.concatenate([predicted[1:] + rng.normal(0, 1, (tracks - 1, 2)),
                             100 + spacing_px * rng.uniform(-1, 1, (false or 0, 2))])
        uv = uv if false is not None else np.empty((0, 2))
        yield name, {'predicted': predicted, 'covariance': covariance, 'uv': uv,
                     'error': round_errors(rng.uniform(0.05, 0.3, len(uv))),
                     'gate_probability': 0.9999, 'detection_probability': 0.9,
                     'image_px2': 250_000.0}


def association_outputs(values: Values) -> Values:
    predicted, covariance = arrays(values, 'predicted', 'covariance')
    uv, error = (array.reshape(-1, *shape) for array, shape in zip(
        arrays(values, 'uv', 'error'), ((2,), (2, 2))))
    detection = DetectionModel(values['gate_probability'], values['detection_probability'],
                               values['image_px2'])
    probability, unassociated, _ = associate(predicted, covariance, uv, error,
                                             (detection.gate, *detection[:3]))
    # By the definition: the density of a centroid about a prediction, 0 outside the gate.
    S = covariance[:, None] + error
    offset = uv - predicted[:, None]
    distance2 = np.einsum('nmi,nmij,nmj->nm', offset, np.linalg.inv(S), offset)
    density = np.where(distance2 <= detection.gate, np.exp(-distance2 / 2) / (
        2 * np.pi * np.sqrt(np.linalg.det(S))), 0.0)
    clutter_px2 = (1 + np.count_nonzero(unassociated)) / values['image_px2']
    missed = 1 - values['detection_probability'] * values['gate_probability']
    weight = density * (values['detection_probability'] / clutter_px2)
    return {'gate': detection.gate, 'density': density, 'unassociated': unassociated,
            'weight': np.column_stack([np.full(len(weight), missed), weight]),
            'probability': probability}


# --- one cycle of the filter of each star ---

def star_filter_inputs() -> Iterator[tuple[str, Values]]:
    rng = np.random.default_rng(12)
    root = rng.normal(0, 1, (2, 4, 4))
    state, covariance = rng.uniform(0, 100, (2, 4)), root @ root.transpose(0, 2, 1)
    for model in ('constant_velocity', 'coordinated_turn'):
        yield model, {
            'model': model, 'dt_s': 0.1, 'acceleration': [0.8, 1.5], 'turn_rate_rad_s': 0.3,
            'state': state, 'covariance': covariance,
            'uv': state[[0, 1, 1]][:, [0, 2]] + rng.normal(0, 1, (3, 2)),
            'variance': [0.1, 0.2, 0.05],
            'probability': [[0.1, 0.9, 0.0, 0.0], [0.05, 0.0, 0.6, 0.35]]}


def star_filter_outputs(values: Values) -> Values:
    acceleration = tuple(values['acceleration'])
    F, Q = (constant_velocity(values['dt_s'], acceleration)
            if values['model'] == 'constant_velocity' else
            coordinated_turn(values['dt_s'], values['turn_rate_rad_s'], acceleration))
    state, covariance = predict(*arrays(values, 'state', 'covariance'), F, Q)
    new_state, new_covariance = update(state, covariance,
                                       *arrays(values, 'uv', 'variance', 'probability'))
    return {'transition': F, 'noise': Q, 'predicted_state': state,
            'predicted_covariance': covariance, 'updated_state': new_state,
            'updated_covariance': new_covariance}


# --- propagation and update of attitude, rate and gyro drift ---

def propagation_inputs() -> Iterator[tuple[str, Values]]:
    rng = np.random.default_rng(13)
    root = rng.normal(0, 1, (9, 9)) * np.repeat([1e-5, 1e-4, 1e-6], 3)[:, None]
    state = {'quaternion': Q, 'rate_rad_s': [0.01, -0.02, 0.03],
             'drift_rad_s': [1e-5, -2e-5, 1e-5], 'covariance': root @ root.T, 'dt_ns': 250_000_000,
             'drift_density': 1e-14}
    yield 'by_rate', {**state, 'by': 'rate', 'acceleration_density': [1e-8, 2e-8, 3e-8]}
    yield 'by_gyro', {**state, 'by': 'gyro',
                      'gyro_dt_ns': [100_000_000, 200_000_000, 300_000_000],
                      'gyro_rate_rad_s': rng.normal(0, 0.02, (3, 3))}


def propagation_outputs(values: Values) -> Values:
    quaternion, rate, drift, covariance = arrays(
        values, 'quaternion', 'rate_rad_s', 'drift_rad_s', 'covariance')
    state, to_ns = (AttitudeState(START_NS, quaternion, rate, drift, covariance),
                    START_NS + values['dt_ns'])
    if values['by'] == 'rate':
        after = state.propagated_at_constant_rate(
            to_ns, *arrays(values, 'acceleration_density'), values['drift_density'])
    else:
        gyro = Gyro()
        gyro.drift_density = values['drift_density']
        for dt_ns, rate_rad_s in zip(values['gyro_dt_ns'], values['gyro_rate_rad_s']):
            gyro.add(START_NS + dt_ns, np.array(rate_rad_s))
        after = gyro.propagate(state, to_ns)
    # A measured attitude 20 arcsec away, whose third axis is not observed.
    information = np.diag([1e10, 2e10, 0.0])
    updated = after.with_attitude(information, information @ (np.array([20.0, -15, 30]) * ARCSEC))
    return {f'{name}_{column}': value for name, found in (('after', after), ('updated', updated))
            for column, value in zip(('quaternion', 'rate_rad_s', 'drift_rad_s', 'covariance'),
                                     found[1:])}


# --- the star tracker as a whole ---

def tracker_inputs() -> Iterator[tuple[str, Values]]:
    camera, rng = SMALL_CAMERA, np.random.default_rng(14)
    onboard, frames = onboard_stars(camera, EPOCH_YEAR, 6.0), []
    for frame in range(5):
        turn = np.array([0.002, -0.001, 0.003]) * frame * 0.1
        centroids, _ = star_list(
            onboard, camera, multiply(Q, quaternion_from_rotation_vector(turn)), 0.1, rng)
        frames.append({'dt_ns': frame * 100_000_000, **list_of(centroids)})
    for model in ('attitude', 'sna'):
        yield model, {'camera': asdict(camera), 'epoch_year': EPOCH_YEAR, 'aberration': 'none',
                      'model': model, 'frames': frames}


def tracker_outputs(values: Values) -> Values:
    tracker = st.StarTracker(camera_of(values), values['epoch_year'],
                             aberration=values['aberration'], model=values['model'],
                             star_identifier={'time_limit_s': 600.0})
    results = [tracker.process_centroids(START_NS + frame['dt_ns'], centroids_of(frame))
               for frame in values['frames']]
    last = results[-1].attitude
    assert last is not None
    later = last.at(last.stamp_ns + 50_000_000)
    return {'states': [result.state.value for result in results],
            'hip': np.sort(results[-1].tracks.hip),
            'quaternion': last.quaternion, 'covariance_sensor': last.covariance_sensor,
            'rate_rad_s': last.rate_rad_s, 'rate_covariance': last.rate_covariance,
            'protection_rad': last.protection_rad, 'quaternion_50_ms_later': later.quaternion,
            'covariance_sensor_50_ms_later': later.covariance_sensor}


# --- tracking, with identifications from elsewhere ---

def tracking_inputs() -> Iterator[tuple[str, Values]]:
    camera, rng = SMALL_CAMERA, np.random.default_rng(15)
    onboard = onboard_stars(camera, EPOCH_YEAR, 6.0)
    near = onboard.within(rotate(Q, [0.0, 0.0, 1.0]), camera.corner_angle_rad + np.radians(1.0))
    stars = replace(onboard, **{name: getattr(onboard, name)[near] for name in STARS})
    sections = {name: {'type': array.dtype.str[1:], 'shape': array.shape, 'values': array}
                for name, array in star_arrays(stars).items()}
    frames = []
    for frame in range(6):
        turn = np.array([0.002, -0.001, 0.003]) * frame * 0.1
        centroids, hip = star_list(
            stars, camera, multiply(Q, quaternion_from_rotation_vector(turn)), 0.1, rng)
        frames.append((native_centroids(centroids), hip))
    for number, model in enumerate(MODELS):
        yield model, {
            'camera': asdict(camera), 'sections': sections, 'model': number,
            'stamp_ns': [10 ** 9 + frame * 100_000_000 for frame in range(len(frames))],
            'count': [len(hip) for _, hip in frames],
            'centroid': np.round(np.concatenate([table for table, _ in frames]), 6),
            'hip': np.concatenate([hip for _, hip in frames])}


def tracking_outputs(values: Values) -> Values:
    content = np.frombuffer(sky_file(values['sections']), np.uint8)
    sky, config = aligned(len(content)), native.defaults()
    sky[:] = content
    config['stages'], config['tracking']['model'] = TRACKS | TRUSTS, values['model']
    tracker = NativeTracker(config, camera_of(values).native, sky)
    tracking, trusted, later = (np.zeros((), kind) for kind in (
        native.TRACKING, native.TRUSTED, native.ATTITUDE))
    first, states, reasons, matched = 0, [], [], []
    for stamp_ns, count in zip(values['stamp_ns'], values['count']):
        table = np.array(values['centroid'][first:first + count])
        hip = native_identified(np.array(values['hip'][first:first + count]), count)
        tracker.call('st_track', stamp_ns, table.ctypes.data, count, None, tracking.ctypes.data)
        tracks = tracker.listed('st_tracks', native.STAR_TRACK)
        tracker.call('st_trust', stamp_ns, tracks.ctypes.data, len(tracks), tracking[
            'attitude'].ctypes.data, trusted.ctypes.data)
        if tracking['state'] != 2:
            tracker.call('st_add_identification', stamp_ns, table.ctypes.data, hip.ctypes.data,
                         count, tracking.ctypes.data)
        states.append(int(tracking['state']))
        reasons.append(int(tracking['reason']['code']))
        matched.append(int(tracking['stars_matched']))
        first += count
    attitude = trusted['attitude']
    native.check(native.library().st_attitude_at(
        attitude.ctypes.data, stamp_ns + 50_000_000, later.ctypes.data))
    return {'state': states, 'reason': reasons, 'stars_matched': matched,
            'quaternion': attitude['quaternion'], 'covariance': attitude['covariance_rad2'],
            'rate': attitude['rate_rad_s'], 'rate_covariance': attitude['rate_covariance'],
            'protection': attitude['protection_rad'], 'quaternion_later': later['quaternion'],
            'covariance_later': later['covariance_rad2']}


STAGES = {
    'camera': Stage(
        'pixels to directions and back, by the distortion models of sensor_msgs/CameraInfo',
        camera_inputs, camera_outputs,
        {'direction': (0, 1e-12), 'projected_pixel': (0, 1e-8), 'flow_px_rad': (1e-10, 0),
         'shown': EXACT, 'quaternion_of_middle': (0, 1e-12),
         'corner_angle_rad': (0, 1e-11)}),
    'rotation': Stage(
        'quaternions, rotation vectors and matrices of rotations',
        rotation_inputs, rotation_outputs,
        {**dict.fromkeys(('quaternion_of_vector', 'quaternion_product', 'quaternion_turned',
                          'vector_of_quaternion', 'attitude_error_rad', 'matrix',
                          'matrix_of_vector', 'sensor_direction',
                          'quaternion_of_matrix', 'matrix_turned', 'quaternion_of_axes'),
                         (0, 1e-14)),
         'sign_continuous': (0, 1e-14), 'angle_rad': (1e-9, 0), 'covariance_icrf': (1e-12, 0)}),
    'linear_algebra': Stage(
        'small symmetric matrices and gates of chi-square',
        algebra_inputs, algebra_outputs,
        {'determinant_3': (1e-9, 0), 'inverse_3': (1e-8, 0), 'cholesky': (1e-11, 0),
         'solution': (1e-7, 0), 'indefinite': EXACT, 'gate': (1e-11, 0)}),
    'sky': Stage(
        'sections of a sky file to its bytes, to answers, and to whether it is accepted damaged',
        sky_inputs, sky_outputs,
        {**dict.fromkeys(('bytes', 'checksum', 'stars_in_cone', 'nearest_pattern_star',
                          'pairs_between', 'accepted'), EXACT), 'direction': (0, 1e-15)}),
    'apparent_places': Stage(
        'catalogue entries to natural and apparent directions of an observer',
        places_inputs, places_outputs,
        {'earth_velocity_m_s': (0, 0.01), 'heliocentric_au': (0, 1e-9),
         'natural_direction': (0, 1e-11), 'apparent_direction': (0, 1e-10),
         'natural_again': (0, 1e-10)}),
    'extraction': Stage(
        'an image to centroids', extraction_inputs, extraction_outputs,
        {'status': EXACT, 'uv': (0, 2e-3), 'flux': (1e-3, 0), 'snr': (1e-2, 0),
         'sigma_px': (1e-2, 0), 'background_dn': (1e-3, 0), 'noise_dn': (1e-2, 0),
         'psf_sigma_px': (0, 2e-3)}),
    'identification': Stage(
        'centroids to catalogue numbers, by each method',
        identification_inputs, identification_outputs,
        {'status': EXACT, 'hip': EXACT, 'quaternion': (0, 1e-9),
         'covariance_sensor': (1e-6, 0), 'residual_px': (0, 1e-5), 'focal_ratio': (0, 1e-8)}),
    'attitude': Stage(
        'directions of identified stars to an attitude with its covariance',
        attitude_inputs, attitude_outputs,
        {'quaternion': (0, 1e-11), 'covariance_sensor': (1e-8, 0), 'covariance_icrf': (1e-8, 0),
         'residual_rad': (0, 1e-11), 'chi2': (1e-6, 1e-9)}),
    'protection': Stage(
        'stars of an attitude to its protection level and the covariance of systematic errors',
        protection_inputs, protection_outputs,
        {'protection_rad': (1e-8, 0), 'velocity_covariance': (1e-8, 0),
         'lens_covariance': (1e-8, 0)}),
    'association': Stage(
        'joint probabilistic data association of centroids and tracks',
        association_inputs, association_outputs,
        {'gate': ROUNDING, 'density': ROUNDING, 'unassociated': EXACT, 'weight': ROUNDING,
         'probability': (0, 1e-9)}),
    'star_filter': Stage(
        'one cycle of the filter of single stars: motion model, prediction, update',
        star_filter_inputs, star_filter_outputs,
        dict.fromkeys(('transition', 'noise', 'predicted_state', 'predicted_covariance',
                       'updated_state', 'updated_covariance'), (1e-10, 0))),
    'propagation': Stage(
        'attitude, rate and gyro drift propagated, then updated by an attitude',
        propagation_inputs, propagation_outputs,
        {f'{name}_{column}': tolerance for name in ('after', 'updated') for column, tolerance in (
            ('quaternion', (0, 1e-12)), ('rate_rad_s', (0, 1e-12)), ('drift_rad_s', (0, 1e-14)),
            ('covariance', (1e-9, 0)))}),
    'star_tracker': Stage(
        'five frames of centroids to the attitude of the last one',
        tracker_inputs, tracker_outputs,
        {'states': EXACT, 'hip': EXACT, 'quaternion': (0, 1e-9), 'covariance_sensor': (1e-5, 0),
         'rate_rad_s': (0, 1e-8), 'rate_covariance': (1e-5, 0), 'protection_rad': (1e-5, 0),
         'quaternion_50_ms_later': (0, 1e-9), 'covariance_sensor_50_ms_later': (1e-5, 0)}),
    'tracking': Stage(
        'six frames of centroids, identified until they are tracked, to a trusted attitude',
        tracking_inputs, tracking_outputs,
        {'state': EXACT, 'reason': EXACT, 'stars_matched': EXACT, 'quaternion': (0, 1e-10),
         'covariance': (1e-7, 0), 'rate': (0, 1e-9), 'rate_covariance': (1e-7, 0),
         'protection': (1e-7, 0), 'quaternion_later': (0, 1e-10), 'covariance_later': (1e-7, 0)})}


def plain(value: Any) -> Any:
    """Return a value as JSON has it: NaN and infinity are null."""
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if isinstance(value, dict):
        return {name: plain(item) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def difference(name: str, expected: Any, found: Any, tolerance: tuple[float, float]) -> float:
    """Return how far a value of plain() is from the expected one, over its tolerance."""
    if tolerance == EXACT:
        return 0.0 if found == expected else np.inf
    # None becomes NaN.
    one, other = np.array(expected, float), np.array(found, float)
    if one.shape != other.shape or not np.array_equal(np.isnan(one), np.isnan(other)):
        return np.inf
    if not np.isfinite(one).any():
        return 0.0
    if 'quaternion' in name and np.sum(one * other) < 0:
        other = -other
    relative, absolute = tolerance
    return float(np.nanmax(np.abs(one - other))
                 / (absolute + relative * np.nanmax(np.abs(one))))


def write(folder: Path, name: str) -> None:
    """Write the vectors of a stage."""
    stage = STAGES[name]
    cases = []
    for case, values in stage.inputs():
        # The outputs are those of the numbers as they are written.
        given = json.loads(json.dumps(plain(values)))
        cases.append({'name': case, 'input': given, 'output': plain(stage.outputs(given))})
    text = json.dumps({'stage': name, 'does': stage.does, 'tolerance': stage.tolerance,
                       'cases': cases}, indent=1)
    # A list of numbers is one line.
    text = re.sub(r'\[[^][{}]*]', lambda found: ' '.join(found[0].split()), text)
    (folder / f'{name}.json').write_text(text + '\n')


if __name__ == '__main__':
    FOLDER.mkdir(exist_ok=True)
    for wanted in sys.argv[1:] or STAGES:
        write(FOLDER, wanted)
