# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""exposure_controller and a driver that is not of this package, in two processes."""

import itertools
from pathlib import Path
import sys

import pytest
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter, parameter_value_to_python
from sensor_msgs.msg import TimeReference
from startracker_ros.io.bags.layouts import ns_from_stamp
from startracker_ros.ros import qos

DRIVER = Path(__file__).with_name('foreign_driver.py')
TASK = 'exposure_controller: exposure'


def start(rig, kind, **parameters):
    rig.processes.run('foreign_driver', [sys.executable, str(DRIVER), kind])
    rig.processes.start('exposure_controller', {
        'driver': 'foreign_driver', 'exposure_parameter': 'exposure', 'gain_parameter': 'gain',
        'exposure_unit_us': 100.0 if kind == 'integer' else 1.0, **parameters})


def values(probe):
    request = GetParameters.Request(names=['exposure', 'gain'])
    return [parameter_value_to_python(value) for value in probe.call(
        GetParameters, '/foreign_driver/get_parameters', request).values]


@pytest.mark.parametrize('kind', ['integer', pytest.param('double', marks=pytest.mark.long)])
def test_a_driver_gets_the_exposure_that_its_stars_ask_for(rig, probe, kind):
    start(rig, kind, exposure_max_ms=400.0)
    probe.collect(TimeReference, 'exposure_start', qos.LIST)
    # It begins at 2 ms, where there are few stars.
    probe.wait(lambda: float(probe.diagnostic_value(TASK, 'exposure_ms') or 0) > 100,
               'a longer exposure')
    probe.wait(lambda: int(probe.diagnostic_value(TASK, 'stars')) > 10, 'stars')
    exposure, gain = values(probe)
    assert type(exposure) is type(gain) is (int if kind == 'integer' else float)
    assert 100 < exposure * (0.1 if kind == 'integer' else 0.001) <= 400 and gain == 3
    exposures_s = [2e-9 * (ns_from_stamp(message.header.stamp) - ns_from_stamp(message.time_ref))
                   for message in probe.received['exposure_start']]
    assert 0.002 <= exposures_s[0] < 0.1 < exposures_s[-1] <= 0.4


@pytest.mark.parametrize('parameters, problem', [
    ({'driver': 'no_such_driver'}, 'no node no_such_driver that has parameters'),
    ({'exposure_parameter': 'shutter'}, 'foreign_driver has no number shutter'),
    ({}, 'exposure of foreign_driver is -1: set it')])
def test_what_does_not_work_is_named(rig, probe, parameters, problem):
    start(rig, 'double', **parameters)
    probe.call(SetParameters, '/foreign_driver/set_parameters', SetParameters.Request(
        parameters=[Parameter('exposure', value=-1.0).to_parameter_msg()]))
    # It may have read the first value meanwhile, and reads again after a change of its own.
    most_ms = itertools.cycle([300.0, 310.0])
    probe.send_until(
        lambda: probe.call(SetParameters, '/exposure_controller/set_parameters',
                           SetParameters.Request(parameters=[Parameter(
                               'exposure_max_ms', value=next(most_ms)).to_parameter_msg()])),
        lambda: probe.find_diagnostic(problem), problem)


def test_an_exposure_that_the_driver_refuses_is_named_and_not_believed(rig, probe):
    start(rig, 'integer', exposure_min_ms=600.0, exposure_max_ms=800.0)
    probe.wait_diagnostic('exposure of foreign_driver is not set: too long for the sensor')
    probe.wait(lambda: probe.diagnostic_value(TASK, 'exposure_ms') == '2', 'the old exposure')
