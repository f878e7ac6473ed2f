# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A camera whose settings are chosen by its images, in a separate thread."""

import time

from changing_sky import photograph, Sky
from limits import HANGS_S
from startracker_ros.core.exposure.control import ExposureOptions, Setting
from startracker_ros.io.images.auto_exposure import AutoExposure
from startracker_ros.io.images.capture import Captured


class Camera:
    """A capture of 5 Hz that has a setting only once it was changed."""

    period_s = 0.2

    def __init__(self):
        self.setting = None
        self.changes = []

    def change(self, setting):
        self.changes.append(setting)
        self.setting = setting._replace(gain=max(setting.gain, 1.0))

    def image(self, number):
        image = photograph(Sky(), self.setting or Setting(1.0, 1.0), number).image
        return Captured(image, number, 'driver', 0.0, self.setting)


def offered(camera, auto, numbers):
    """Offer images, each after the one before was used."""
    for number in numbers:
        captured = camera.image(number)
        auto.figures = None
        auto.offer(captured)
        deadline_s = time.monotonic() + HANGS_S
        while captured.setting is not None and auto.figures is None:
            assert time.monotonic() < deadline_s
            time.sleep(0.001)


def test_it_begins_and_ends_at_a_setting_with_many_stars_also_after_a_loss():
    camera = Camera()
    auto = AutoExposure(ExposureOptions(), camera, 0.0)
    offered(camera, auto, range(8))
    assert camera.changes[0] == Setting(100.0, -1.0)
    assert camera.setting == Setting(200.0, 1.0) and len(auto.figures.flux) > 20
    # The device is opened again, with settings of its own.
    camera.setting, before = None, len(camera.changes)
    offered(camera, auto, range(12))
    assert len(camera.changes) == before + 1 and camera.setting == Setting(200.0, 1.0)
    auto.close()
