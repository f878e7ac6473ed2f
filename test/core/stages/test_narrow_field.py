# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A camera of 3 deg: all stages have the same deep stars, whose numbers pass through messages."""

import re

import numpy as np
import pytest
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.deep import load_deep_catalog, NUMBER_OFFSET, star_name
from startracker_ros.core.catalog.onboard import onboard_catalog
from startracker_ros.core.centroid.synthetic_field import star_list
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.maths.rotation import ARCSEC, attitude_error, quaternion_from_pointing
from startracker_ros.core.stages.attitude import AttitudeStage
from startracker_ros.core.stages.identification import IdentificationStage
from startracker_ros.core.stages.tracking import make_track_filter
from startracker_ros.core.track.track_filter import TrackerState
from startracker_ros.io.bags.layouts import STAR_DTYPE

CAMERA, YEAR = Camera.from_fov(1024, 1024, 3.0), 2026.5


@pytest.mark.slow
def test_a_narrow_camera_identifies_tracks_and_publishes():
    sky = onboard_catalog(load_deep_catalog(), CAMERA, YEAR, 9.5)
    q = quaternion_from_pointing(*np.radians([200.0, 25.0, 40.0]))
    identification = IdentificationStage(CAMERA, YEAR, IdentificationOptions(magnitude_limit=9.5))
    tracker, attitude = make_track_filter(CAMERA, YEAR), AttitudeStage(CAMERA, YEAR)
    rng = np.random.default_rng(1)
    for frame in range(5):
        stamp_ns = 1_780_000_000 * 10 ** 9 + frame * 10 ** 8
        seen, true = star_list(sky, CAMERA, q, 0.2, rng)
        found, centroids = identification.identify(stamp_ns, seen)
        np.testing.assert_array_equal(found.hip[found.hip > 0], true[found.hip > 0])
        tracks = tracker.update(stamp_ns, centroids)
        if tracker.state is not TrackerState.TRACKING:
            tracker.identified(stamp_ns, centroids, found.hip)
    deep = found.hip > NUMBER_OFFSET
    assert np.count_nonzero(deep) >= 3
    assert tracker.state is TrackerState.TRACKING
    assert np.count_nonzero(tracks.hip[tracks.usable] > NUMBER_OFFSET) >= 3
    for trusted in (attitude.from_stars(stamp_ns, centroids, found.hip),
                    attitude.from_tracks(stamp_ns, tracks, tracker.attitude)):
        assert np.hypot(*attitude_error(trusted.attitude.quaternion, q)[:2]) < 2 * ARCSEC
    rows = np.zeros(len(found.hip), STAR_DTYPE)
    rows['hip'] = found.hip
    np.testing.assert_array_equal(rows['hip'].astype(np.int32), found.hip)
    assert star_name(11767) == 'HIP 11767'
    # A star without a number has the name that surveys give it by its position.
    catalog = load_deep_catalog()
    star = int(np.flatnonzero(catalog.hip > NUMBER_OFFSET)[0])
    match = re.fullmatch(r'J(\d\d)(\d\d)([\d.]{4})([+-])(\d\d)(\d\d)(\d\d)',
                         star_name(int(catalog.hip[star])))
    hours, minutes, seconds, sign, degrees, arcmin, arcsec = match.groups()
    x, y, z = catalog.rows(slice(star, star + 1)).directions(2000.0)[0]
    ra_deg = 15 * (int(hours) + int(minutes) / 60 + float(seconds) / 3600)
    dec_deg = int(degrees) + int(arcmin) / 60 + int(arcsec) / 3600
    assert 0 <= np.degrees(np.arctan2(y, x)) % 360 - ra_deg < 15 / 36000
    assert 0 <= abs(np.degrees(np.arcsin(z))) - dec_deg < 1 / 3600 and (sign == '-') == (z < 0)
