# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Where the attitude of a recording must not be interpolated."""

import numpy as np
from startracker_ros.io.recordings.recording import Recording

# Fewer frames than this may be missing, as a busy recorder loses them, within one lock.
_GAP_INTERVALS = 3.0


def lock_segments(recording: Recording) -> np.ndarray:
    """
    Return the number (N,) of the segment of each attitude, from 0; a new one at loss of lock.

    The lock is lost where the estimator says of a frame that it has no attitude
    (attitude_imu); in a bag without that, where the tracker stops TRACKING; and always where
    more than three usual intervals lie between two attitudes, of which nothing is known.
    """
    stamps = recording.attitude_ns
    if not len(stamps):
        return np.zeros(0, int)
    begins = np.zeros(len(stamps) + 1, bool)
    if len(recording.times['attitude_imu']):
        begins[np.searchsorted(stamps, recording.without_attitude_ns)] = True
    else:
        tracking = np.array([state == 'TRACKING' for state in recording.state], bool)
        lost = 1 + np.flatnonzero(tracking[:-1] & ~tracking[1:])
        received = np.maximum.accumulate(recording.attitude_received_ns)
        begins[np.searchsorted(received, recording.state_ns[lost])] = True
    intervals = np.diff(stamps)
    if len(intervals):
        begins[1:-1] |= intervals > _GAP_INTERVALS * np.median(intervals)
    begins[0] = False
    return np.cumsum(begins[:-1])
