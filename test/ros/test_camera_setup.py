# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What a camera that changes with each message costs: one thread that builds, and the newest."""

from threading import Event

from limits import HANGS_S
from startracker_ros.core.camera.model import Camera
from startracker_ros.ros.camera_node import CameraSetup


def test_only_the_newest_camera_is_built_after_the_one_in_progress():
    started, go_on, built = Event(), Event(), []

    def build(number):
        started.set()
        assert go_on.wait(HANGS_S)
        built.append(number)
        return number
    camera = Camera.from_fov(64, 64, 12.0)
    setups = []
    for number in range(5):
        for older in setups:
            older.superseded = True
        setups.append(CameraSetup(camera, lambda number=number: build(number)))
        assert started.wait(HANGS_S)
    go_on.set()
    for setup in setups:
        setup._thread.join(HANGS_S)
    assert all(setup.is_done for setup in setups)
    assert built == [0, 4] and setups[-1].built() == 4
