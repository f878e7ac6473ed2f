"""A run and a browser for the tests of this folder."""

from collections.abc import Iterator
from pathlib import Path

from browser import browser_page, BrowserError, Page
import pytest
from run_bag import write_run


@pytest.fixture(scope='session')
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bag of a whole run."""
    return write_run(tmp_path_factory.mktemp('report') / 'run')


@pytest.fixture(scope='session')
def page() -> Iterator[Page]:
    """Return a tab of headless Chromium; the tests fail where there is none."""
    try:
        with browser_page() as page:
            yield page
    except BrowserError as error:
        pytest.fail(str(error))
