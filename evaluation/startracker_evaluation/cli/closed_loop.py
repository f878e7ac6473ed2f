# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Command that closes the loop around a simulated spacecraft: demo closed-loop."""

from pathlib import Path

import click
from startracker_ros.tools.cli.outcome import exit_1_on
from startracker_ros.tools.cli.shared import (
    finish_measured as finish, json_option, output_option, seed_option)


@click.command('closed-loop')
@output_option('demo_closed_loop', 'Folder for bag, pictures, report page and logs.')
@seed_option
@json_option
def demo_closed_loop(output: Path, seed: int, as_json: bool) -> None:
    """Control a spacecraft of Basilisk by what the star tracker sees."""
    from startracker_evaluation.gnc.basilisk_messages import import_basilisk
    import_basilisk()
    from startracker_evaluation.harness.closed_loop_demo import run_closed_loop_demo
    from startracker_ros.ros.processes import HarnessError
    with exit_1_on(HarnessError):
        result = run_closed_loop_demo(output, seed=seed)
    finish(result, as_json)
