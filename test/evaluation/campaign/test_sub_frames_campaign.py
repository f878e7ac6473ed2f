# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The attitudes between the frames of a rolling shutter, compared with their bound."""

import numpy as np
import pytest
from startracker_evaluation.campaign import sub_frames
from startracker_evaluation.campaign.sub_frames import sub_frame_runs, SUB_FRAMES
from startracker_ros.core.frame_result import Attitude


@pytest.fixture
def short(monkeypatch):
    monkeypatch.setattr(sub_frames, 'FRAMES', 40)


def test_a_fast_turn_is_known_between_its_frames(short):
    sums = sub_frame_runs('turn at 5 deg/s', 2, 3)
    assert sums.due == sums.published == 40 and sums.attitudes == 40 * SUB_FRAMES
    assert sums.wrong == 0 and 1 < sums.by_covariance / sums.attitudes < 4.5
    assert np.sqrt(sums.by_bound / sums.attitudes / 3) < 1


def test_an_attitude_that_stays_would_be_wrong(short, monkeypatch):
    monkeypatch.setattr(sub_frames, 'SUB_FRAMES', 1)
    right = sub_frame_runs('sway 0.2 deg, 2 s', 1, 3)
    monkeypatch.setattr(Attitude, 'at', lambda self, stamp_ns: self)
    monkeypatch.setattr(sub_frames, 'SUB_FRAMES', 2)
    stays = sub_frame_runs('sway 0.2 deg, 2 s', 1, 3)
    assert right.wrong == 0 and stays.attitudes == 40 and stays.wrong > 30
