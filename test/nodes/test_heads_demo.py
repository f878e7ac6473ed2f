# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The demo of three heads over the nodes: the Moon leaves one, the Sun blinds another."""

import numpy as np
import pytest
from startracker_ros.io.recordings.loading import load_recording
from startracker_ros.ros.processes import set_environment
from startracker_ros.tools.report.heads import load_heads

BEGIN_S, SECONDS = 44.0, 24.0


@pytest.fixture(scope='module')
def demo(tmp_path_factory):
    from startracker_ros.tools.demos.heads_demo import FRAME_RATE_HZ, HeadsDemo
    set_environment(isolated=True)
    with HeadsDemo(tmp_path_factory.mktemp('demo'), BEGIN_S) as demo:
        demo.start(1, width=256, height=256)
        demo.run(round(SECONDS * FRAME_RATE_HZ))
        demo.finish()
        yield demo


def test_each_head_is_blinded_and_returns_as_forecast(demo):
    history = demo.history()
    assert [(b.head, b.body) for b in history.blindings] == [
        ('tracker_1', 'Moon'), ('tracker_3', 'Sun')]
    # The glare is in the images: at the start and at the end a head has no stars.
    assert not history.has_attitude['tracker_1'][:10].any()
    assert not history.has_attitude['tracker_3'][-10:].any()
    assert history.has_attitude['tracker_1'][-10:].all()
    assert history.has_attitude['tracker_2'][10:].all()
    starts, ends = history.forecast_errors_s()
    assert len(starts) > 10 and np.abs(starts).max() <= 6.0
    assert len(ends) > 5 and np.abs(ends).max() <= 6.0


def test_the_fused_attitude_is_right_without_a_jump(demo):
    history, recording, heads = demo.history(), load_recording(demo.bag), load_heads(demo.bag)
    assert recording.namespace == ''
    rows = {row.case: row for row in history.rows(recording, heads)}
    assert rows['wrong fused attitudes'].ours == 0
    assert rows['largest jump where a head drops out or returns'].holds
    assert rows['after blinding: identified frame to attitude, most'].holds
    used = heads.in_use(history.stamp_ns)
    assert not used['tracker_1'][0] and used['tracker_1'][-1] and not used['tracker_3'][-1]
    assert set(heads.mounts) == {'tracker_2', 'tracker_3'}
    for series in heads.mounts.values():
        # A mount is published as unknown until two heads have been seen together.
        known = np.isfinite(series.sigma_arcsec()).all(axis=1)
        assert np.count_nonzero(~known) <= 1
        # The recorder may discover the truth some frames after the mounts.
        compared = known & np.isfinite(series.error_arcsec()).all(axis=1)
        assert np.count_nonzero(compared) > 5
        assert (np.abs(series.error_arcsec()) < 5 * series.sigma_arcsec())[compared].all()


def test_report_and_picture_show_heads_and_mounts(demo, tmp_path):
    from startracker_ros.tools.report.page import write_report
    write_report(demo.bag, tmp_path / 'report.html')
    text = (tmp_path / 'report.html').read_text()
    for part in ('id="section-heads"', 'id="heads-2"', 'id="mount-1-z"', 'mount of tracker_3'):
        assert part in text
    demo.history().draw(tmp_path / 'heads.png', load_recording(demo.bag), load_heads(demo.bag))
    assert (tmp_path / 'heads.png').stat().st_size > 50_000
