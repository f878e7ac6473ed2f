"""A run and a browser for the tests of this folder."""

from collections.abc import Iterator
from pathlib import Path

from browser import browser_page, Page
import pytest
from run_bag import write_run


@pytest.fixture(scope='session')
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bag of a whole run."""
    return write_run(tmp_path_factory.mktemp('report') / 'run')


@pytest.fixture(scope='session')
def page() -> Iterator[Page]:
    """Return a tab of headless Chromium; tests that use it do not run where there is none."""
    with browser_page() as page:
        yield page
