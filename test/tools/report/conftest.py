# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A run for the tests of this folder."""

from pathlib import Path

import pytest
from run_bag import write_run


@pytest.fixture(scope='session')
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bag of a whole run."""
    return write_run(tmp_path_factory.mktemp('report') / 'run')
