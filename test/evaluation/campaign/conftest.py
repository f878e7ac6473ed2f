# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Photographs for campaigns."""

from pathlib import Path

import pytest


@pytest.fixture(scope='session')
def few_photographs(sky_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of every third of the real star images that somebody has solved."""
    few = tmp_path_factory.mktemp('photographs')
    for name in ('night-sky-11deg', 'night-sky-6deg'):
        header, *rows = (sky_data / name / 'solutions.csv').read_text().splitlines()
        column = header.split(',').index('ra_deg')
        rows = [row for row in rows if row.split(',')[column]][::3]
        (few / name).mkdir()
        (few / name / 'solutions.csv').write_text('\n'.join([header, *rows]))
        for row in rows:
            file, *_ = row.split(',')
            (few / name / file).symlink_to(sky_data / name / file)
    return few
