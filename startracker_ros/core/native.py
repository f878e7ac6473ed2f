# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The native core, libstartracker.so, by ctypes: its structs as NumPy types, its functions.

The headers of native/include have the meaning and the unit of each field; a test compares names,
types and places of all fields with them. Loading fails where library and types are of two
versions.
"""

import ctypes
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

LIBRARY = Path(__file__).with_name('libstartracker.so')
VERSION = 3
"""ST_VERSION of the header that the types below are of."""

_FIGURES, _BODIES, _REJECTIONS = 9, 16, 11  # ST_REASON_FIGURES, ST_MOST_BODIES, ST_REJECTED_COUNT
_LIMITS, _PARAMETERS = 6, 11  # ST_MOST_LIMITS, ST_MOST_LENS_PARAMETERS

_ALIGNMENT = 64

REMEDY = 'install the package again; in a checkout, python native/build.py'


class NativeError(RuntimeError):
    """The library cannot be loaded, or was used wrongly; the text says why, in a line."""


# --- structs ---


def _struct(**fields: Any) -> np.dtype:
    """Return the type of a struct of the header, out of names with types."""
    return np.dtype([(name, *kind) if isinstance(kind, tuple) else (name, kind)
                     for name, kind in fields.items()], align=True)


def _numbers(names: str, kind: str = 'f8') -> dict[str, str]:
    """Return names with the type that they share."""
    return dict.fromkeys(names.split(), kind)


_VECTOR, _QUATERNION, _MATRIX = ('f8', 3), ('f8', 4), ('f8', (3, 3))

ABI = _struct(**_numbers(
    'version config camera image sky observer hint centroid identified track prediction rejected '
    'result attitude fault', 'u4'))
FAULT = _struct(name='u8', **_numbers('value least most'))
CAMERA = _struct(**_numbers('width_px height_px', 'i4'), **_numbers('fx_px fy_px cx_px cy_px'),
                 distortion=('f8', 8), **_numbers('model reserved', 'i4'))
IMAGE = _struct(pixels='u8', stride_bytes='i8', **_numbers(
    'width_px height_px type cell', 'i4'), exposure_s='f8')
SKY = _struct(file='u8', bytes='u8')
BODY = _struct(direction=_VECTOR, **_numbers('error_rad radius_rad magnitude'))
OBSERVER = _struct(
    velocity_m_s=_VECTOR, velocity_sigma_m_s='f8', heliocentric_au=_VECTOR,
    epoch_sigma_years='f8', zenith=_VECTOR, refraction_a_rad='f8', refraction_b_rad='f8',
    max_age_s='f8', body=(BODY, _BODIES), **_numbers('body_count aberration', 'i4'))
HINT = _struct(stamp_ns='i8', quaternion=_QUATERNION, covariance_rad2=_MATRIX, rate_rad_s=_VECTOR,
               rate_covariance=_MATRIX)

EXTRACTION_OPTIONS = _struct(
    **_numbers('threshold_sigma threshold_dn psf_sigma_px exposure_s line_time_us '
               'search_period_s'),
    **_numbers('threshold method max_stars max_stars_lost readout_up reserved', 'i4'))
IDENTIFICATION_OPTIONS = _struct(
    **_numbers('tolerance_sigmas sigma_floor_px fov_error_percent false_alarm_max most_work_s '
               'check_period_s slice_s'), **_numbers('max_image_stars reserved', 'i4'))
TRACKING_OPTIONS = _struct(
    **_numbers('magnitude_limit acceleration_deg_s2 roll_acceleration_deg_s2 sigma_floor_px '
               'detection_probability gate_probability magnitude_tolerance max_residual_px '
               'max_rate_deg_s max_gap_s'),
    **_numbers('max_stars min_stars max_missed confirm_frames max_bad_frames model solver '
               'association sna_confirmation roll_by_gyro', 'i4'))
GYRO_OPTIONS = _struct(**_numbers(
    'gyro_drift_deg_h gyro_noise_deg_sqrt_h gyro_range_deg_s gyro_rate_change_deg_s2'))
TRUST_OPTIONS = _struct(
    **_numbers('max_residual_px misleading_probability false_star_probability'),
    **_numbers('solver min_stars', 'i4'))
CAPACITIES = _struct(**_numbers(
    'peaks centroids rejected tracks predictions candidates frames rates', 'i4'))
CONFIG = _struct(
    abi=ABI, stages='i4', epoch_year='f8', capacities=CAPACITIES, extraction=EXTRACTION_OPTIONS,
    identification=IDENTIFICATION_OPTIONS, tracking=TRACKING_OPTIONS, gyro=GYRO_OPTIONS,
    trust=TRUST_OPTIONS)

REASON = _struct(**_numbers('code reserved', 'i4'), figure=('f8', _FIGURES))
CENTROID = _struct(**_numbers(
    'u_px v_px flux_dn snr sigma_px cov_uu_px2 cov_uv_px2 cov_vv_px2 common_uu_px2 common_uv_px2 '
    'common_vv_px2 delay_s'))
IDENTIFIED = _struct(**_numbers('magnitude residual_px residual_rad'),
                     **_numbers('hip reserved', 'i4'))
STAR_TRACK = _struct(
    **_numbers('u_px v_px u_rate_px_s v_rate_px_s cov_uu_px2 cov_uv_px2 cov_vv_px2 magnitude '
               'flux_dn snr sigma_px residual_px distance_px association_probability'),
    hip='i4', track_id='u4', **_numbers('age missed', 'i4'))
PREDICTION = _struct(**_numbers('u_px v_px u_rate_px_s v_rate_px_s sigma_px'),
                     **_numbers('hip reserved', 'i4'))
REJECTED = _struct(**_numbers('u_px v_px'), **_numbers('kind reserved', 'i4'))

ATTITUDE = _struct(
    quaternion=_QUATERNION, covariance_rad2=_MATRIX, rate_rad_s=_VECTOR, rate_covariance=_MATRIX,
    cross_covariance=_MATRIX, acceleration_rad_s2=_VECTOR, jerk_rad_s3=_VECTOR,
    acceleration_sigma_rad_s2=_VECTOR, acceleration_sigma_before_rad_s2=_VECTOR,
    protection_rad=_VECTOR, **_numbers('chi2 residual_px'), stamp_ns='i8',
    **_numbers('valid stars', 'i4'))
BUDGET = _struct(**dict.fromkeys(
    ('stars', 'motion', 'exposure', 'stamps', 'shutter', 'lens', 'observer', 'epoch'), _MATRIX))
EXTRACTION = _struct(
    **_numbers('background_dn noise_dn psf_sigma_px exposure_least_s exposure_most_s streak_u_px '
               'streak_v_px streak_roll_rad streak_at_u_px streak_at_v_px'),
    **_numbers('centroids centroids_left_out rejected rejected_listed', 'i4'),
    rejected_by_kind=('i4', _REJECTIONS), windowed='i4', reason=REASON)
IDENTIFICATION = _struct(
    attitude=ATTITUDE, **_numbers('focal_ratio false_alarm_probability work_s'),
    **_numbers('status stars body_centroids candidates', 'i4'), reason=REASON)
TRACKING = _struct(
    attitude=ATTITUDE, frame_attitude=ATTITUDE, **_numbers('residual_px stamp_sigma_s'),
    **_numbers('state gyro tracks tracks_left_out predictions stars_matched frames_since_fix '
               'late_frames rejected_centroids checks_passed', 'i4'),
    budget=BUDGET, frame_budget=BUDGET, reason=REASON, contradiction=REASON, gyro_trouble=REASON)
TRUSTED = _struct(attitude=ATTITUDE, reason=REASON)
RESULT = _struct(
    attitude=ATTITUDE, reason=REASON, extraction=EXTRACTION,
    identification=IDENTIFICATION, tracking=TRACKING, stamp_ns='i8',
    **_numbers('aberration used', 'i4'))

STREAK = _struct(**_numbers('u_px v_px roll_rad at_u_px at_v_px'))
SEARCH_OPTIONS = _struct(threshold_factor='f8', **_numbers(
    'most_stars points_only narrow reserved', 'i4'))
PAIRS = _struct(**_numbers('star direction separation_rad below member previous', 'u8'),
                **_numbers('stars pairs', 'i4'))
PATTERNS = _struct(
    **_numbers('hip direction magnitude blended start member', 'u8'), bright=PAIRS, pairs=PAIRS,
    scale_error='f8',
    **_numbers('stars cells bright_image_stars bright_triangles most_centroids '
               'bases_by_brightness lens_unknown in_cells', 'i4'))
IMAGE_STARS = _struct(**_numbers('direction sigma_rad', 'u8'), **_numbers('count reserved', 'i4'))
VERIFICATION = _struct(attitude=ATTITUDE, **_numbers('focal_ratio false_alarm_probability'))
QUAD_TABLE = _struct(**_numbers('code side_rad start', 'u8'))
QUAD_LEVEL = _struct(**_numbers('direction start member', 'u8'),
                     **_numbers('side longest crowd'),
                     **_numbers('stars cells most_inner reserved', 'i4'))
TRIANGLE_TABLE = _struct(**_numbers('side_rad star start neighbour', 'u8'),
                         **_numbers('low_rad high_rad'), **_numbers('neighbours reserved', 'i4'))
LENS_PRIOR = _struct(start=CAMERA, free=('f8', _PARAMETERS),
                     **_numbers('parameters reserved', 'i4'))
FITTED_LENS = _struct(
    camera=CAMERA, quaternion=_QUATERNION, covariance=('f8', (_PARAMETERS, _PARAMETERS)),
    **_numbers('error_px probability'), **_numbers('folds reserved', 'i4'))
SKY_AND_SPOTS = _struct(**_numbers('direction spot_px sigma_px', 'u8'),
                        **_numbers('stars spots', 'i4'))
STAR_CELLS = _struct(**_numbers('direction start member', 'u8'), **_numbers('stars cells', 'i4'))

DETECTION = _struct(
    **_numbers('gate gate_probability detection_probability image_px2 clutter_px2'),
    **_numbers('association reserved', 'i4'))
TRACKED_STARS = _struct(**_numbers('direction uv sigma_px', 'u8'),
                        **_numbers('count reserved', 'i4'))
FRAME_FIT = _struct(turn_rad=_VECTOR, covariance_rad2=_MATRIX, lens=('f8', 5),
                    **_numbers('stars reserved', 'i4'))
GRAVITY = _struct(**_numbers('mu_m3_s2 radius_m j2'))
LIMIT = _struct(name='u8', value='f8')
CHECK = _struct(
    name='u8', **_numbers('probability threshold'), **_numbers('dof frames reason limits', 'i4'),
    limit=(LIMIT, _LIMITS))

FUSION_OPTIONS = _struct(
    **_numbers('horizon_s max_gap_s max_gyro_gap_s acceleration_deg_s2 correlation_s'),
    **_numbers('start_heads agree_frames exclude_frames reserved', 'i4'))
MOUNT_OPTIONS = _struct(**_numbers(
    'mount_sigma_arcsec mount_walk_arcsec_sqrt_h mount_temperature_arcsec_k mount_orbit_arcsec '
    'orbit_period_s'))
FUSION_CONFIG = _struct(fusion=FUSION_OPTIONS, mount=MOUNT_OPTIONS, gyro=GYRO_OPTIONS,
                        **_numbers('heads frames rates reserved', 'i4'))
MOUNT = _struct(
    quaternion=_QUATERNION, covariance_rad2=_MATRIX, law=_MATRIX, law_covariance=('f8', (12, 12)),
    **_numbers('time_offset_s temperature_c'),
    **_numbers('has_covariance has_law has_law_covariance reserved', 'i4'))
FUSED = _struct(
    quaternion=_QUATERNION, covariance_rad2=_MATRIX, rate_rad_s=_VECTOR, rate_covariance=_MATRIX,
    drift_rad_s=_VECTOR, drift_covariance=_MATRIX, stamp_ns='i8',
    **_numbers('valid reserved', 'i4'))
HEAD = _struct(reason=REASON, noise_scale='f8', **_numbers(
    'state silent stands_out needs_temperature used repeated late ahead disagreeing '
    'not_counted_yet', 'i4'))
MOUNT_STEP = _struct(stamp_ns='i8', size_rad=_VECTOR, sigma_rad=_VECTOR,
                     **_numbers('head reserved', 'i4'))

READOUT = _struct(**_numbers('full_well_e read_noise_e dn_per_e bias_dn top_dn', 'f4'))

STRUCTS = {f'st_{name.lower()}': kind for name, kind in list(globals().items())
           if isinstance(kind, np.dtype) and not name.startswith('_')}
"""All structs by their name in the header."""


def this_abi() -> np.ndarray:
    """Return the st_abi of these types."""
    abi = np.zeros((), ABI)
    abi['version'] = VERSION
    for name in ABI.names[1:]:  # type: ignore[index]  # a struct has names
        abi[name] = STRUCTS[{'track': 'st_star_track'}.get(name, f'st_{name}')].itemsize
    return abi


# --- the library ---

_POINTER, _COUNT, _STATUS, _TEXT = (
    ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int, ctypes.c_char_p)
_STAMP, _FLAG, _NUMBER = ctypes.c_int64, ctypes.c_int32, ctypes.c_double
_HEAD = ctypes.c_int32
FUNCTIONS: dict[str, tuple[Any, tuple[Any, ...]]] = {
    'st_check_abi': (_STATUS, (_POINTER,)),
    'st_build_text': (_TEXT, ()),
    'st_status_text': (_TEXT, (_STATUS,)),
    'st_defaults': (_STATUS, (_POINTER, _POINTER)),
    'st_check_config': (_STATUS, (_POINTER, _POINTER)),
    'st_check_camera': (_STATUS, (_POINTER, _POINTER)),
    'st_check_sky': (_STATUS, (_POINTER, _POINTER)),
    'st_project': (_STATUS, (_POINTER, _POINTER, _POINTER, _COUNT)),
    'st_unproject': (_STATUS, (_POINTER, _POINTER, _POINTER, _COUNT)),
    'st_image_flow': (_STATUS, (_POINTER, _POINTER, _POINTER, _COUNT)),
    'st_size': (_STATUS, (_POINTER,) * 4),
    'st_create': (_STATUS, (_POINTER, _COUNT, *(_POINTER,) * 5)),
    'st_reset': (_STATUS, (_POINTER,)),
    'st_change_options': (_STATUS, (_POINTER,) * 3),
    'st_extract': (_STATUS, (_POINTER, _STAMP, _POINTER, _POINTER, _COUNT, _STAMP, _FLAG,
                             _POINTER)),
    'st_centroids': (_POINTER, (_POINTER, _POINTER)),
    'st_rejections': (_POINTER, (_POINTER, _POINTER)),
    'st_identify': (_STATUS, (_POINTER, _STAMP, _POINTER, _COUNT, _NUMBER, _POINTER, _POINTER)),
    'st_identify_on': (_STATUS, (_POINTER, _NUMBER, _POINTER, _POINTER)),
    'st_identified_stars': (_POINTER, (_POINTER, _POINTER)),
    'st_searched_centroids': (_POINTER, (_POINTER, _POINTER)),
    'st_size_for': (_STATUS, (_POINTER,) * 5),
    'st_create_for': (_STATUS, (_POINTER, _COUNT, *(_POINTER,) * 6)),
    'st_usable_stars': (_STATUS, ((_POINTER,) * 3 + (_COUNT, _NUMBER) + (_POINTER,) * 4)),
    'st_support': (_STATUS, (*(_POINTER,) * 4, _COUNT, _POINTER)),
    'st_verify': (_STATUS, (*(_POINTER,) * 4, _COUNT, _NUMBER, *(_POINTER,) * 4)),
    'st_verify_quads': (_STATUS, (*(_POINTER,) * 4, _COUNT, _NUMBER, _NUMBER, _POINTER,
                                  _POINTER)),
    'st_add_rate': (_STATUS, (_POINTER, _STAMP, _POINTER)),
    'st_add_observer': (_STATUS, (_POINTER, _STAMP, _POINTER)),
    'st_add_hint': (_STATUS, (_POINTER, _POINTER)),
    'st_attitude_at': (_STATUS, (_POINTER, _STAMP, _POINTER)),
    'st_identification_is_due': (_FLAG, (_POINTER, _STAMP, ctypes.c_int, _FLAG)),
    'st_track': (_STATUS, (_POINTER, _STAMP, _POINTER, _COUNT, _POINTER, _POINTER)),
    'st_prepare': (_STATUS, (_POINTER,)),
    'st_add_identification': (_STATUS, (_POINTER, _STAMP, _POINTER, _POINTER, _COUNT, _POINTER)),
    'st_known': (_STATUS, (_POINTER, _POINTER)),
    'st_tracks': (_POINTER, (_POINTER, _POINTER)),
    'st_predictions': (_POINTER, (_POINTER, _POINTER)),
    'st_trust': (_STATUS, (_POINTER, _STAMP, _POINTER, _COUNT, _POINTER, _POINTER)),
    'st_trust_stars': (_STATUS, (_POINTER, _STAMP, _POINTER, _POINTER, _COUNT, _POINTER)),
    'st_residuals': (_POINTER, (_POINTER, _POINTER)),
    'st_process_image': (_STATUS, (_POINTER, _STAMP, _POINTER, _POINTER)),
    'st_process_centroids': (_STATUS, (_POINTER, _STAMP, _POINTER, _COUNT, _POINTER, _FLAG,
                                       _POINTER)),
    'st_searched_size': (_STATUS, (_POINTER, _POINTER)),
    'st_search': (_STATUS, (_POINTER,) * 8),
    'st_search_near': (_STATUS, ((_POINTER,) * 4 + (_COUNT,) + (_POINTER,) * 4)),
    'st_find_spots': (_STATUS, (_POINTER, _POINTER, _NUMBER, _FLAG)),
    'st_find_highest_peaks': (_STATUS, (_POINTER, _POINTER)),
    'st_measure_widths': (_STATUS, ((_POINTER,) * 4 + (_COUNT, _POINTER))),
    'st_full_scale': (_STATUS, (_POINTER, _POINTER, _NUMBER, _POINTER)),
    'st_cycle_size': (_STATUS, (_COUNT, _COUNT, _POINTER)),
    'st_cycle': (_STATUS, (_POINTER, _COUNT, *(_POINTER,) * 5, _COUNT, _POINTER, _POINTER, _COUNT,
                           _POINTER)),
    'st_fit_frame': (_STATUS, (*(_POINTER,) * 5, _COUNT, *(_POINTER,) * 5)),
    'st_propagate_orbit': (None, (_POINTER, _NUMBER, _FLAG, _POINTER)),
    'st_fit_attitude': (_STATUS, (_FLAG, *(_POINTER,) * 3, _COUNT, *(_POINTER,) * 4, _COUNT)),
    'st_protection_level': (_STATUS, (_POINTER, _POINTER, _COUNT, _NUMBER, _NUMBER, _FLAG,
                                      _POINTER)),
    'st_pairs_within': (_STATUS, (_POINTER, _COUNT, _POINTER, _POINTER, _FLAG, _NUMBER,
                                  *(_POINTER,) * 3)),
    'st_match_quads': (_STATUS, (_POINTER, _POINTER, _COUNT, _POINTER, _COUNT, *(_NUMBER,) * 3,
                                 *(_POINTER,) * 4)),
    'st_make_quads': (_STATUS, (_POINTER,) * 10),
    'st_quad_cells': (_STATUS, (_POINTER, _COUNT, _POINTER)),
    'st_sort_by_cell': (_STATUS, (_POINTER, _COUNT, _FLAG, _POINTER, _POINTER)),
    'st_brightest_of_cells': (_STATUS, (_POINTER, _POINTER, _COUNT, _POINTER, _FLAG, _FLAG,
                                        _POINTER, _POINTER)),
    'st_make_triangles': (_STATUS, (_POINTER, _COUNT, _POINTER, _POINTER, *(_NUMBER,) * 3,
                                    *(_POINTER,) * 4)),
    'st_few_stars': (_STATUS, (*(_POINTER,) * 3, _NUMBER, _NUMBER, *(_POINTER,) * 5)),
    'st_support_in_cells': (_STATUS, (_POINTER, _POINTER, _NUMBER, _POINTER, _POINTER, _COUNT,
                                      _NUMBER, _POINTER)),
    'st_fit_lens': (_STATUS, (*(_POINTER,) * 5, _COUNT)),
    'st_gated_stars': (_STATUS, (_POINTER, _FLAG, _NUMBER, *(_POINTER,) * 3, _COUNT)),
    'st_grow_lens': (_STATUS, (*(_POINTER,) * 5, _COUNT, *(_POINTER,) * 3, _COUNT)),
    'st_stars_in_image': (_STATUS, (*(_POINTER,) * 3, _COUNT, *(_POINTER,) * 3)),
    'st_checks': (_POINTER, (_POINTER,)),
    'st_fusion_defaults': (_STATUS, (_POINTER, _HEAD)),
    'st_fusion_size': (_STATUS, (_POINTER,) * 3),
    'st_fusion_create': (_STATUS, (_POINTER, _COUNT, *(_POINTER,) * 4)),
    'st_fusion_reset': (_STATUS, (_POINTER,)),
    'st_fusion_add_rate': (_STATUS, (_POINTER, _STAMP, _POINTER)),
    'st_fusion_add_frame': (_STATUS, (_POINTER, _HEAD, _STAMP, *(_POINTER,) * 3)),
    'st_fusion_add_temperature': (_STATUS, (_POINTER, _HEAD, _NUMBER)),
    'st_fusion_state': (_STATUS, (_POINTER,) * 4),
    'st_fusion_head': (_STATUS, (_POINTER, _HEAD, _STAMP, _POINTER)),
    'st_fusion_mount': (_STATUS, (_POINTER, _HEAD, _STAMP, *(_POINTER,) * 3)),
    'st_fusion_learnt': (_STATUS, (_POINTER, _HEAD, _POINTER)),
    'st_fusion_steps': (_POINTER, (_POINTER, _POINTER)),
    'st_alias_tables': (None, (_POINTER, _COUNT, _POINTER)),
    'st_read_out': (None, (_POINTER, _COUNT, ctypes.c_uint64, *(_POINTER,) * 5)),
    'st_digitise': (None, (_POINTER, _COUNT, _POINTER, _POINTER)),
    'st_add_starlight': (None, (*(_POINTER,) * 3, _COUNT, _POINTER, _FLAG, _FLAG, _POINTER)),
    'st_add_trails': (None, (_POINTER, _COUNT, _NUMBER, _NUMBER, _POINTER, _FLAG, _FLAG,
                             _POINTER)),
    'st_add_tracks': (None, (_POINTER, _COUNT, _FLAG, _FLAG, _POINTER)),
    'st_bloom': (None, (_POINTER, _FLAG, _FLAG, _NUMBER))}
"""What each function returns and takes."""


@cache
def library(path: Path = LIBRARY) -> ctypes.CDLL:
    """Return the library, loaded once; NativeError where it is not of this version."""
    if not path.is_file():
        raise NativeError(f'{path} is missing: {REMEDY}')
    try:
        loaded = ctypes.CDLL(str(path))
        for name, (result, arguments) in FUNCTIONS.items():
            function = getattr(loaded, name)
            function.restype, function.argtypes = result, arguments
    except (OSError, AttributeError) as error:
        raise NativeError(f'{path} is not a library of this version and machine ({error}): '
                          f'{REMEDY}') from error
    abi = this_abi()
    status = loaded.st_check_abi(abi.ctypes.data)
    if status:
        raise NativeError(f'{path}: {loaded.st_status_text(status).decode()}: {REMEDY}')
    return loaded


def build_text() -> str:
    """Return compiler, oldest processor and version of the library, in a line."""
    return str(library().st_build_text().decode())


def check(status: int, fault: np.ndarray | None = None) -> None:
    """Raise NativeError for a status that is not ok, with the number that was refused."""
    if not status:
        return
    text = library().st_status_text(status).decode()
    if fault is not None and fault['name']:
        name = ctypes.string_at(int(fault['name'])).decode()
        text = (f'{name} = {fault["value"]:g} is not within {fault["least"]:g} .. '
                f'{fault["most"]:g}: {text}')
    raise NativeError(text)


def call(name: str, *arguments: Any) -> None:
    """Call a function, with the addresses of arrays; NativeError for a status that is not ok."""
    check(getattr(library(), name)(*(
        argument.ctypes.data if isinstance(argument, np.ndarray) else argument
        for argument in arguments)))


def defaults() -> np.ndarray:
    """Return a CONFIG with all options at their defaults."""
    config, abi = np.zeros((), CONFIG), this_abi()
    check(library().st_defaults(config.ctypes.data, abi.ctypes.data))
    return config


# --- trackers ---


class NativeTracker:
    """
    A tracker with the stages of a CONFIG, in memory of its own; one thread uses it at a time.

    sky is a file in memory or mapped, None for a tracker that needs none. patterns are PATTERNS
    that are identified by instead of those of the sky, with the arrays that they are of.
    NativeError as of st_create().
    """

    def __init__(self, config: np.ndarray, camera: np.ndarray, sky: np.ndarray | None = None,
                 patterns: tuple[np.ndarray, list[np.ndarray]] | None = None) -> None:
        self.config, self._library, self.handle = config, library(), ctypes.c_void_p()
        file = None if sky is None else np.array((sky.ctypes.data, len(sky)), SKY)
        size, fault, kind = ctypes.c_size_t(), np.zeros((), FAULT), ''
        given = [config.ctypes.data, camera.ctypes.data, address_of(file)]
        if patterns is not None:
            given.append(patterns[0].ctypes.data)
            kind = '_for'
        check(getattr(self._library, f'st_size{kind}')(*given, ctypes.byref(size)))
        # Memory of the caller, for as long as the tracker lives.
        self._sky, self._patterns, self._memory = sky, patterns, aligned(size.value)
        check(getattr(self._library, f'st_create{kind}')(
            self._memory.ctypes.data, size.value, *given, ctypes.byref(self.handle),
            fault.ctypes.data), fault)
        self.count = ctypes.c_size_t()
        self._count_at = ctypes.byref(self.count)

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function with the tracker and arguments; NativeError for wrong use."""
        status = getattr(self._library, name)(self.handle, *arguments)
        if status:
            check(status)

    def status_of(self, name: str, *arguments: Any) -> int:
        """Return what a function returns that may refuse its input."""
        return int(getattr(self._library, name)(self.handle, *arguments))

    def change_options(self) -> None:
        """Use what was changed in config without loss of lock; NativeError if it is not live."""
        fault = np.zeros((), FAULT)
        check(self.status_of('st_change_options', self.config.ctypes.data, fault.ctypes.data),
              fault)

    def listed(self, name: str, kind: np.dtype, none: bool = False) -> Any:
        """Return a copy of a list of the last call; where none, None instead of a null pointer."""
        first = getattr(self._library, name)(self.handle, self._count_at)
        if none and first is None:
            return None
        table = np.empty(self.count.value, kind)
        ctypes.memmove(table.ctypes.data, first, table.nbytes)
        return table


def aligned(size: int) -> np.ndarray:
    """Return memory (size,) uint8 as the library needs it."""
    block = np.empty(size + _ALIGNMENT, np.uint8)
    first = -block.ctypes.data % _ALIGNMENT
    return block[first:first + size]


def address_of(array: np.ndarray | None) -> int | None:
    """Return where an array is; None for none."""
    return None if array is None else array.ctypes.data


def check_sky(path: Path) -> None:
    """Raise NativeError, which names the file, unless the library accepts a sky file; OSError."""
    if not path.stat().st_size:
        raise NativeError(f'{path}: it is empty')
    file, fault = np.memmap(path, np.uint8, 'r'), np.zeros((), FAULT)
    sky = np.array((file.ctypes.data, len(file)), SKY)
    try:
        check(library().st_check_sky(sky.ctypes.data, fault.ctypes.data), fault)
    except NativeError as error:
        raise NativeError(f'{path}: {error}') from error


@cache
def checks() -> dict[str, np.ndarray]:
    """Return all checks of integrity by name, each a CHECK."""
    count = ctypes.c_size_t()
    table = library().st_checks(ctypes.byref(count))
    found = np.frombuffer(ctypes.string_at(table, CHECK.itemsize * count.value), CHECK)
    return {text_at(one['name']): one for one in found}


def text_at(address: np.integer) -> str:
    """Return the text of the library at an address."""
    return ctypes.string_at(int(address)).decode()
