# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The values of `tracker_state`, as the node publishes them and as reprocessing writes them."""

from startracker_ros.core.track.track_filter import TrackFilter

NAME = 'star_tracker: state'


def tracker_state_values(tracker: TrackFilter) -> dict[str, object]:
    """Return the values of a tracker after its newest frame."""
    return {
        'stars_matched': tracker.stars_matched,
        'residual_px': f'{tracker.residual_px:.3f}',
        'frames_since_fix': tracker.frames_since_fix,
        'checks_passed': tracker.checks_passed,
        'late_frames': tracker.late_frames,
        'rejected_centroids': tracker.rejected_centroids,
        'gyro': tracker.gyro_condition,
        'stamp_sigma_ms': f'{tracker.stamp_sigma_s * 1e3:.3f}',
        'reason': tracker.contradiction or tracker.reason}
