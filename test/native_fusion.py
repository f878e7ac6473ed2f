# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The fusion of heads of the native core for tests, by ctypes: startracker_fusion.h."""

import ctypes
from functools import cache
from pathlib import Path

from native_core import kernels
import numpy as np
from startracker_ros.core.native import GYRO_OPTIONS, REASON

FUSION_OPTIONS = np.dtype([
    *((name, float) for name in (
        'horizon_s', 'max_gap_s', 'max_gyro_gap_s', 'acceleration_deg_s2', 'correlation_s')),
    *((name, np.int32) for name in (
        'start_heads', 'agree_frames', 'exclude_frames', 'reserved'))])
MOUNT_OPTIONS = np.dtype([(name, float) for name in (
    'mount_sigma_arcsec', 'mount_walk_arcsec_sqrt_h', 'mount_temperature_arcsec_k',
    'mount_orbit_arcsec', 'orbit_period_s')])
CONFIG = np.dtype([('fusion', FUSION_OPTIONS), ('mount', MOUNT_OPTIONS), ('gyro', GYRO_OPTIONS),
                   *((name, np.int32) for name in ('heads', 'frames', 'rates', 'reserved'))])
MOUNT = np.dtype([
    ('quaternion', float, 4), ('covariance_rad2', float, (3, 3)), ('law', float, (3, 3)),
    ('law_covariance', float, (12, 12)), ('time_offset_s', float), ('temperature_c', float),
    *((name, np.int32) for name in (
        'has_covariance', 'has_law', 'has_law_covariance', 'reserved'))])
FUSED = np.dtype([
    ('quaternion', float, 4), ('covariance_rad2', float, (3, 3)), ('rate_rad_s', float, 3),
    ('rate_covariance', float, (3, 3)), ('drift_rad_s', float, 3),
    ('drift_covariance', float, (3, 3)), ('stamp_ns', np.int64), ('valid', np.int32),
    ('reserved', np.int32)])
HEAD = np.dtype([
    ('reason', REASON), ('noise_scale', float), *((name, np.int32) for name in (
        'state', 'silent', 'stands_out', 'needs_temperature', 'used', 'repeated', 'late', 'ahead',
        'disagreeing', 'not_counted_yet'))])
STEP = np.dtype([('stamp_ns', np.int64), ('size_rad', float, 3), ('sigma_rad', float, 3),
                 ('head', np.int32), ('reserved', np.int32)])
STRUCTS = {'st_fusion_options': FUSION_OPTIONS, 'st_mount_options': MOUNT_OPTIONS,
           'st_fusion_config': CONFIG, 'st_mount': MOUNT, 'st_fused': FUSED, 'st_head': HEAD,
           'st_mount_step': STEP}
STATES = ('waiting', 'checked', 'used', 'excluded')
RECORD = Path(__file__).parent / 'native' / 'fusion.npz'


@cache
def library() -> ctypes.CDLL:
    loaded = kernels()
    pointer, whole, real, stamp = (
        ctypes.c_void_p, ctypes.c_int32, ctypes.c_double, ctypes.c_int64)
    for name, arguments in {
            'defaults': (pointer, whole), 'size': (pointer,) * 3,
            'create': (pointer, ctypes.c_size_t, *(pointer,) * 4), 'reset': (pointer,),
            'add_rate': (pointer, stamp, pointer),
            'add_frame': (pointer, whole, stamp, *(pointer,) * 3),
            'add_temperature': (pointer, whole, real), 'state': (pointer,) * 4,
            'head': (pointer, whole, stamp, pointer),
            'mount': (pointer, whole, stamp, *(pointer,) * 3),
            'learnt': (pointer, whole, pointer), 'steps': (pointer, pointer)}.items():
        function = getattr(loaded, f'st_fusion_{name}')
        function.argtypes = arguments
        function.restype = pointer if name == 'steps' else ctypes.c_int
    return loaded


def call(name: str, *arguments) -> int:
    """Call a function with arrays and numbers; return its status."""
    return getattr(library(), f'st_fusion_{name}')(*(
        one.ctypes.data if isinstance(one, np.ndarray) else one for one in arguments))


def defaults(heads: int, **options) -> np.ndarray:
    """Return st_fusion_config with these options, by their names in its three parts."""
    config = np.zeros((), CONFIG)
    assert call('defaults', config, heads) == 0
    for name, value in options.items():
        part = next((part for part in ('fusion', 'mount', 'gyro')
                     if name in config.dtype[part].names), None)
        if part is None:
            config[name] = value
        else:
            config[part][name] = value
    return config


def mounts_of(quaternions, **numbers) -> np.ndarray:
    """Return st_mount of quaternions (N, 4), with what is known of them by its fields."""
    mounts = np.zeros(len(quaternions), MOUNT)
    mounts['quaternion'], mounts['temperature_c'] = quaternions, np.nan
    for name, value in numbers.items():
        mounts[name] = value
        if f'has_{name}' in MOUNT.names:
            mounts[f'has_{name}'] = 1
    return mounts


class Fusion:
    """A fusion in memory of its own."""

    def __init__(self, config: np.ndarray, mounts: np.ndarray) -> None:
        size, fault = np.zeros(1, np.uintp), np.zeros(4)
        assert call('size', config, mounts, size) == 0
        self._memory = np.zeros(int(size[0]) + 64, np.uint8)
        self.bytes = int(size[0])
        begin = -self._memory.ctypes.data % 64
        self._aligned = self._memory[begin:begin + self.bytes]
        handle = ctypes.c_void_p()
        status = call('create', self._aligned, self.bytes, config, mounts, ctypes.byref(handle),
                      fault)
        assert status == 0, status
        self.handle = handle.value

    def reset(self) -> None:
        assert call('reset', self.handle) == 0

    def add_rate(self, stamp_ns: int, rate: np.ndarray) -> bool:
        return call('add_rate', self.handle, int(stamp_ns), np.array(rate, float)) == 0

    def add_frame(self, head: int, stamp_ns: int, quaternion: np.ndarray, covariance: np.ndarray
                  ) -> np.ndarray | None:
        """Return the fused attitude, None where there is none."""
        fused = np.zeros((), FUSED)
        status = call('add_frame', self.handle, head, int(stamp_ns),
                      np.array(quaternion, float), np.array(covariance, float, order='C'), fused)
        assert status == 0, status
        assert fused['valid'] or np.isnan(fused['quaternion']).all()
        return fused if fused['valid'] else None

    def add_temperature(self, head: int, celsius: float) -> bool:
        return call('add_temperature', self.handle, head, float(celsius)) == 0

    @property
    def trouble(self) -> np.ndarray:
        return self._state()[0]

    @property
    def gyro_trouble(self) -> np.ndarray:
        return self._state()[1]

    @property
    def uses_gyro(self) -> bool:
        return bool(self._state()[2])

    def _state(self):
        reasons, uses = np.zeros(2, REASON), np.zeros(1, np.int32)
        assert call('state', self.handle, reasons[:1], reasons[1:], uses) == 0
        return reasons[0], reasons[1], uses[0]

    def head(self, number: int, stamp_ns: int = 0) -> np.ndarray:
        head = np.zeros((), HEAD)
        assert call('head', self.handle, number, int(stamp_ns), head) == 0
        return head

    def state(self, number: int) -> str:
        return STATES[self.head(number)['state']]

    def mount(self, number: int, stamp_ns: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return q_body_from_sensor (4,), the misalignment (3,) and its covariance (3, 3)."""
        found = np.zeros(4), np.zeros(3), np.zeros((3, 3))
        assert call('mount', self.handle, number, int(stamp_ns), *found) == 0
        return found

    def learnt(self, number: int) -> np.ndarray:
        mount = np.zeros((), MOUNT)
        assert call('learnt', self.handle, number, mount) == 0
        return mount

    @property
    def steps(self) -> np.ndarray:
        """Return the steps of the last frame (N,) STEP."""
        count = np.zeros(1, np.uintp)
        address = library().st_fusion_steps(self.handle, count.ctypes.data)
        if not count[0]:
            return np.zeros(0, STEP)
        size = int(count[0]) * STEP.itemsize
        return np.frombuffer(ctypes.string_at(address, size), STEP)


def find_steps(heads: int, head, stamp_ns, offset, variance, law) -> np.ndarray:
    """Return the steps (S,) of offsets (N, 3) of heads (N,) with law (N, L)."""
    arrays = [np.array(head, np.int32), np.array(stamp_ns, np.int64),
              *(np.array(one, float, order='C') for one in (offset, variance, law))]
    steps = np.zeros(16, STEP)
    places = [one.ctypes.data for one in arrays]
    count = kernels().stt_find_steps(heads, len(arrays[0]), *places[:4], arrays[4].shape[1],
                                     places[4], steps.ctypes.data, len(steps))
    return steps[:count]
