# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Exposure time and gain of another camera driver, which has them as parameters of its node."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
import math
import time
from typing import Any

import numpy as np
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.node import Node
from rclpy.task import Future
from startracker_ros.core.exposure.control import Setting
from startracker_ros.core.options import option, Options

# A driver that has not discovered the client yet does not answer.
_ANSWER_S = 3.0
# Images that are exposed already, or wait in the driver or in DDS, when a setting is made.
_UNCHANGED = 3
_STAMPS = 11
_NUMBERS = {ParameterType.PARAMETER_INTEGER: 'integer_value',
            ParameterType.PARAMETER_DOUBLE: 'double_value'}


@dataclass(frozen=True)
class DriverOptions(Options):
    """The node of a camera driver, and its parameters; the defaults are those of usb_cam."""

    driver: str = option('usb_cam', 'node of the camera driver', read_only=True)
    exposure_parameter: str = option(
        'exposure_time_absolute', 'parameter of the driver with the exposure time; its automatic '
        'exposure has to be off', read_only=True)
    exposure_unit_us: float = option(
        100.0, 'unit of that parameter: 100 as Video4Linux, 1 as GenICam and libcamera, 1000 '
        'where it is in ms', unit='us', low=0.001, high=1e9, read_only=True)
    gain_parameter: str = option(
        '', 'parameter of the driver with the gain, for gain_min and gain_max; empty: the gain '
        'stays', read_only=True)


class DriverSettings:
    """
    Sets the parameters of a driver, and reads them back: what it has counts.

    period_s is the median time between the first images.
    """

    def __init__(self, node: Node, options: DriverOptions) -> None:
        self._options = options
        self._names = [name for name in (options.exposure_parameter, options.gain_parameter)
                       if name]
        self._get = node.create_client(GetParameters, f'{options.driver}/get_parameters')
        self._set = node.create_client(SetParameters, f'{options.driver}/set_parameters')
        self.forget()

    def forget(self) -> None:
        """Forget all, for another series of images."""
        self._stamps_ns: list[int] = []
        self._values: list[ParameterValue] = []
        self._wanted: Setting | None = None
        self._unread = self._rejected = ''
        self._request: Future | None = None
        self._give_up_s, self._unchanged = 0.0, 0

    @property
    def period_s(self) -> float:
        """Period of the images, infinite before the second one."""
        steps = np.diff(self._stamps_ns)
        return float(np.median(steps)) * 1e-9 if len(steps) else math.inf

    @property
    def problem(self) -> str:
        """What does not work, empty where all does."""
        return self._unread or self._rejected

    def change(self, setting: Setting) -> None:
        """Set exposure time, and gain where the driver has it, after the next image."""
        self._wanted = setting

    def of_image(self, stamp_ns: int) -> Setting | None:
        """Return the setting of the newest image, None where it is not known."""
        if len(self._stamps_ns) < _STAMPS:
            self._stamps_ns.append(stamp_ns)
        if not (self._get.service_is_ready() and self._set.service_is_ready()):
            self._unread = f'no node {self._options.driver} that has parameters'
            # One that comes back begins with others.
            self._values = []
            return None
        if self._request is not None and time.monotonic() < self._give_up_s:
            return None
        if not self._values:
            self._ask(self._get.call_async(GetParameters.Request(names=self._names)),
                      self._on_values)
            return None
        if self._wanted is not None:
            self._write(self._wanted)
            return None
        if self._unchanged:
            self._unchanged -= 1
            return None
        exposure, *gain = map(_number, self._values)
        return Setting(exposure * self._options.exposure_unit_us / 1e3, gain[0] if gain else -1.0)

    def _write(self, setting: Setting) -> None:
        """Request a setting, in the types that the parameters have."""
        units = max(setting.exposure_ms * 1e3 / self._options.exposure_unit_us, 1.0)
        request = SetParameters.Request(parameters=[
            Parameter(name=name, value=ParameterValue(
                type=value.type, double_value=float(number), integer_value=round(number)))
            for name, value, number in zip(self._names, self._values, (units, setting.gain))])
        self._wanted = None
        # They are read back, whatever the answer is.
        self._values, self._unchanged = [], _UNCHANGED
        self._ask(self._set.call_async(request), self._on_change)

    def _ask(self, request: Future, use: Callable[[Any], None]) -> None:
        self._request, self._give_up_s = request, time.monotonic() + _ANSWER_S
        request.add_done_callback(partial(self._on_answer, use))

    def _on_answer(self, use: Callable[[Any], None], request: Future) -> None:
        """Use an answer, unless it was given up."""
        if request is self._request:
            self._request = None
            use(request.result())

    def _on_values(self, answer: GetParameters.Response) -> None:
        # Some drivers answer with no values where one is missing.
        values = [*answer.values, *[ParameterValue()] * len(self._names)]
        no_numbers = [name for name, value in zip(self._names, values)
                      if value.type not in _NUMBERS]
        self._values = [] if no_numbers or _number(values[0]) <= 0 else list(answer.values)
        self._unread = ('' if self._values else f'{self._options.driver} has no number '
                        f'{" and no ".join(no_numbers)}' if no_numbers else
                        f'{self._names[0]} of {self._options.driver} is {_number(values[0]):g}: '
                        'set it, and its automatic exposure off')

    def _on_change(self, answer: SetParameters.Response) -> None:
        self._rejected = '; '.join(
            f'{name} of {self._options.driver} is not set: {result.reason}'
            for name, result in zip(self._names, answer.results) if not result.successful)


def _number(value: ParameterValue) -> float:
    return float(getattr(value, _NUMBERS[value.type]))
