# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Commands of the package, run in the process of the test."""

from typing import Any

from click.testing import CliRunner, Result
from startracker_ros.command_line import main

try:
    # What click before 8.2 calls it; later versions always keep the streams apart.
    _RUNNER = CliRunner(mix_stderr=False)  # type: ignore[call-arg]
except TypeError:
    _RUNNER = CliRunner()


def invoke(*arguments: str, **options: Any) -> Result:
    """Return exit code, stdout and stderr of `startracker ARGUMENTS`."""
    return _RUNNER.invoke(main, arguments, **options)
