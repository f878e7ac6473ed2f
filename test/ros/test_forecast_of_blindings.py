# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitude from which a head without stars looks ahead: the newest one, turned to now."""

from types import SimpleNamespace

import numpy as np
import pytest
from startracker_ros.core.astro.bodies import BODIES, bodies_from_earth
from startracker_ros.core.astro.epoch import epoch_year_from_stamp
from startracker_ros.core.astro.exclusion import ExclusionOptions, HORIZON_S
from startracker_ros.core.astro.observer_motion import ObserverMotion
from startracker_ros.core.maths.rotation import quaternion_from_axes, turned
from startracker_ros.core.track.tracks import Hint
from startracker_ros.ros.star_tracker_output import TrackerStateOutput

STAMP_NS = 1_790_000_000_000_000_000
RATE = np.radians([0.0, 0.5, 0.0])


def attitude(time_s):
    """Return a boresight that turns towards the Sun; 80 deg off at time 0."""
    sun = bodies_from_earth(epoch_year_from_stamp(STAMP_NS)).direction[BODIES.index('Sun')]
    side = np.cross(sun, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    q = quaternion_from_axes(sun, np.cross(sun, side))
    return turned(q, RATE * (time_s - 160.0))


def forecast(output, time_s, tracked=True, hint=None, start_ns=STAMP_NS):
    tracker = SimpleNamespace(newest_hint=hint, attitude=SimpleNamespace(
        attitude=SimpleNamespace(quaternion=attitude(time_s)), rate_rad_s=RATE)
        if tracked else None)
    values = output._forecast(tracker, start_ns + round(time_s * 1e9))
    return float(values['seconds_to_blinding']) if values else None


def test_the_newest_attitude_counts_and_is_turned_to_now():
    node = SimpleNamespace(advertise=lambda *_: None,
                           options=lambda _: ExclusionOptions(sun_exclusion_deg=30.0))
    output = TrackerStateOutput(node, SimpleNamespace(motion=ObserverMotion()))
    old = Hint(STAMP_NS, attitude(-50.0), np.eye(3), RATE, np.eye(3))
    assert forecast(output, 0.0, tracked=False) is None
    assert forecast(output, 0.0, tracked=False, hint=old) == pytest.approx(149.5, abs=1.0)
    blinded_s = forecast(output, 0.0, hint=old)
    assert blinded_s == pytest.approx(99.5, abs=1.0)
    # Without stars: its own attitude is newer than the hint, which has the same stamp.
    assert forecast(output, 20.0, tracked=False, hint=old) == pytest.approx(
        blinded_s - 20.0, abs=0.2)
    newer = Hint(STAMP_NS + 10 ** 10, attitude(0.0), np.eye(3), RATE, np.eye(3))
    assert forecast(output, 20.0, tracked=False, hint=newer) == pytest.approx(
        blinded_s - 10.0, abs=0.2)
    assert forecast(output, HORIZON_S + 20.0, tracked=False, hint=newer) is None
    # Where the Sun is, stamps since boot do not say.
    assert forecast(output, 0.0, start_ns=100 * 10 ** 9) is None
