# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The stars as the observer sees them are computed once for each frame."""

from collections import Counter

from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.astro.observer_motion import ObserverMotion
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.star_tracker import StarTracker
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator

EPOCH_YEAR = 2026.5
CAMERA = Camera.from_fov(512, 512, 16.0)
START_NS, STEP_NS = stamp_from_epoch_year(EPOCH_YEAR), 100_000_000
FRAMES = 6


def test_the_sky_of_a_frame_is_computed_once(monkeypatch):
    computed, compute = Counter(), ObserverMotion._at

    def counted(motion, stamp_ns, no_date):
        computed[stamp_ns] += 1
        return compute(motion, stamp_ns, no_date)

    monkeypatch.setattr(ObserverMotion, '_at', counted)
    simulator = SkySimulator(
        CAMERA, motion_from_options(MotionOptions(motion='inertial')), load_catalog(), EPOCH_YEAR,
        seed=1)
    tracker = StarTracker(CAMERA, EPOCH_YEAR)
    published = 0
    for index in range(FRAMES):
        frame, stamp_ns = simulator.frame(index * STEP_NS * 1e-9), START_NS + index * STEP_NS
        if not index:
            # It is propagated from here, so that the observer moves from frame to frame.
            tracker.add_observer(stamp_ns, frame.state.position_m, frame.state.velocity_m_s)
        published += tracker.process(stamp_ns, frame.image).attitude is not None
    assert published >= FRAMES - 2
    assert computed == {START_NS + index * STEP_NS: 1 for index in range(FRAMES)}
