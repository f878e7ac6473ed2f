"""What tests of every room use."""

import os
from pathlib import Path

from hypothesis import settings
import pytest

# The machine that runs the tests is shared: no example fails for being slow, all are repeatable.
settings.register_profile('startracker', deadline=None, derandomize=True, print_blob=True)
settings.load_profile('startracker')


@pytest.fixture(scope='session')
def sky_data() -> Path:
    """Return the folder of real star images; STARTRACKER_DATA names another one."""
    default = Path(__file__).parents[2] / 'shared' / 'data'
    folder = Path(os.environ.get('STARTRACKER_DATA', default))
    if not (folder / 'night-sky-11deg' / 'solutions.csv').is_file():
        pytest.fail(f'no real star images in {folder}: set STARTRACKER_DATA to their folder')
    return folder
