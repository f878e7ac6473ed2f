# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A fusion of the native library: its memory and its calls, heads by name."""

from collections.abc import Mapping
import ctypes
from typing import Any

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.fusion.mounts import Mount, MountOptions, native_mount
from startracker_ros.core.fusion.options import FusionOptions
from startracker_ros.core.fusion.reasons import fusion_reason
from startracker_ros.core.native import aligned
from startracker_ros.core.native_tracker import set_options

_FRAME_S, _MOST_FRAMES, _SPARE_FRAMES = 0.01, 2000, 16
"""Capacity: frames of each head at 100 Hz within horizon_s. What is not used takes no memory."""


class NativeFusion:
    """
    A fusion in memory of its own; one thread uses it at a time.

    names are those of the heads, numbers their places. ValueError for no heads, more than the
    library has room for, or what is not a mount.
    """

    def __init__(self, mounts: Mapping[str, Mount], options: FusionOptions,
                 mount_options: MountOptions, gyro_options: GyroErrorOptions) -> None:
        if not mounts:
            raise ValueError('no heads')
        self.names = tuple(mounts)
        self.numbers = {name: number for number, name in enumerate(mounts)}
        self._library, self._handle = native.library(), ctypes.c_void_p()
        config, fault = np.zeros((), native.FUSION_CONFIG), np.zeros((), native.FAULT)
        native.check(self._library.st_fusion_defaults(config.ctypes.data, len(mounts)))
        set_options(config['fusion'], options)
        set_options(config['mount'], mount_options)
        set_options(config['gyro'], gyro_options)
        config['frames'] = _SPARE_FRAMES + len(mounts) * min(
            round(options.horizon_s / _FRAME_S), _MOST_FRAMES)
        table = np.array([native_mount(mount) for mount in mounts.values()])
        given, size = (config.ctypes.data, table.ctypes.data), ctypes.c_size_t()
        # What it refuses the next call names.
        self._library.st_fusion_size(*given, ctypes.byref(size))
        self._memory = aligned(size.value)
        try:
            native.check(self._library.st_fusion_create(
                self._memory.ctypes.data, size.value, *given, ctypes.byref(self._handle),
                fault.ctypes.data), fault)
        except native.NativeError as error:
            raise ValueError(f'{", ".join(mounts)} cannot be fused: {error}') from error

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function st_fusion_... with the fusion and arguments; NativeError."""
        native.check(self.status_of(name, *arguments))

    def status_of(self, name: str, *arguments: Any) -> int:
        """Return the status of a function that may refuse its input."""
        return int(getattr(self._library, f'st_fusion_{name}')(self._handle, *arguments))

    def steps(self) -> np.ndarray:
        """Return the steps (S,) of mounts, MOUNT_STEP, that the last frame has shown."""
        count = ctypes.c_size_t()
        first = self._library.st_fusion_steps(self._handle, ctypes.byref(count))
        size = count.value * native.MOUNT_STEP.itemsize
        return np.frombuffer(ctypes.string_at(first, size) if size else b'', native.MOUNT_STEP)

    def sentence(self, reason: np.ndarray) -> str:
        """Return the sentence of an st_reason, empty where there is none."""
        return fusion_reason(reason, self.names)
