# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The fusion of heads of the native core for tests, by ctypes: startracker_fusion.h."""

import ctypes
from pathlib import Path

from native_core import kernels
import numpy as np
from startracker_ros.core.native import (
    FUSED, FUSION_CONFIG, HEAD, MOUNT, MOUNT_STEP, REASON)

STATES = ('waiting', 'checked', 'used', 'excluded')
RECORD = Path(__file__).parent / 'native' / 'fusion.npz'


def call(name: str, *arguments) -> int:
    """Call a function with arrays and numbers; return its status."""
    return getattr(kernels(), f'st_fusion_{name}')(*(
        one.ctypes.data if isinstance(one, np.ndarray) else one for one in arguments))


def defaults(heads: int, **options) -> np.ndarray:
    """Return st_fusion_config with these options, by their names in its three parts."""
    config = np.zeros((), FUSION_CONFIG)
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

    def estimated(self, number: int) -> np.ndarray:
        mount = np.zeros((), MOUNT)
        assert call('learnt', self.handle, number, mount) == 0
        return mount

    @property
    def steps(self) -> np.ndarray:
        """Return the steps of the last frame (N,) MOUNT_STEP."""
        count = np.zeros(1, np.uintp)
        address = kernels().st_fusion_steps(self.handle, count.ctypes.data)
        if not count[0]:
            return np.zeros(0, MOUNT_STEP)
        size = int(count[0]) * MOUNT_STEP.itemsize
        return np.frombuffer(ctypes.string_at(address, size), MOUNT_STEP)


def find_steps(heads: int, head, stamp_ns, offset, variance, law) -> np.ndarray:
    """Return the steps (S,) of offsets (N, 3) of heads (N,) with law (N, L)."""
    arrays = [np.array(head, np.int32), np.array(stamp_ns, np.int64),
              *(np.array(one, float, order='C') for one in (offset, variance, law))]
    steps = np.zeros(16, MOUNT_STEP)
    places = [one.ctypes.data for one in arrays]
    count = kernels().stt_find_steps(heads, len(arrays[0]), *places[:4], arrays[4].shape[1],
                                     places[4], steps.ctypes.data, len(steps))
    return steps[:count]
