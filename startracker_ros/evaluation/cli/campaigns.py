# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The group campaign: published tables repeated, long runs."""

from pathlib import Path

import click
from startracker_ros.tools.cli.outcome import Commands, exit_1_on
from startracker_ros.tools.cli.shared import (
    check_names, check_pictures, finish_measured as finish, json_option, picture_option,
    scheduler_option, seed_option, trials_option)


@click.group(cls=Commands)
def campaign() -> None:
    """Repeat the published tables, the paper's figure beside ours."""


@campaign.command('hausdorff')
@trials_option(200, 'Directions of each figure.')
@picture_option('the times')
@scheduler_option
@seed_option
@json_option
def campaign_hausdorff(trials: int, output: Path | None, scheduler: str, seed: int,
                       as_json: bool) -> None:
    """Find sets of bright stars by their Hausdorff distance in a field of 12 deg."""
    from startracker_ros.evaluation.campaign.hausdorff import run_hausdorff_campaign
    finish(run_hausdorff_campaign(trials=trials, seed=seed, scheduler=scheduler, output=output),
           as_json)


@campaign.command('quad')
@trials_option(300, 'Frames along the orbit, and as many of the whole sky.')
@picture_option('the angles along the orbit')
@scheduler_option
@seed_option
@json_option
def campaign_quad(trials: int, output: Path | None, scheduler: str, seed: int,
                  as_json: bool) -> None:
    """Quads of stars found by k-vector in a field of 20.3 deg."""
    from startracker_ros.evaluation.campaign.quad import run_quad_campaign
    finish(run_quad_campaign(trials=trials, seed=seed, scheduler=scheduler, output=output),
           as_json)


@campaign.command('extended-grid')
@trials_option(10_000, 'Directions of each figure.')
@picture_option('each figure of the paper')
@scheduler_option
@seed_option
@json_option
def campaign_extended_grid(trials: int, output: Path | None, scheduler: str, seed: int,
                           as_json: bool) -> None:
    """Fields of 4 deg with few stars, known by a gyro and grids beyond the edge."""
    from startracker_ros.evaluation.campaign.extended_grid import run_extended_grid_campaign
    finish(run_extended_grid_campaign(trials=trials, seed=seed, scheduler=scheduler,
                                      output=output), as_json)


@campaign.command('jpdaf')
@trials_option(100, 'Runs of 400 frames in each cell.')
@picture_option('the figures of the paper')
@scheduler_option
@seed_option
@json_option
def campaign_jpdaf(trials: int, output: Path | None, scheduler: str, seed: int,
                   as_json: bool) -> None:
    """Four stars tracked by JPDAF through turns, straight lines and jitter."""
    from startracker_ros.evaluation.campaign.jpdaf import run_jpdaf_campaign
    finish(run_jpdaf_campaign(trials=trials, seed=seed, scheduler=scheduler, output=output),
           as_json)


@campaign.command('two-satellite')
@trials_option(100_000, 'Draws of the figures beyond the 500 of the paper.', least=1000)
@picture_option('the errors')
@seed_option
@json_option
def campaign_two_satellite(trials: int, output: Path | None, seed: int, as_json: bool) -> None:
    """Locate a target by the cameras of two satellites under four sources of error."""
    from startracker_ros.evaluation.campaign.two_satellite import run_two_satellite_campaign
    finish(run_two_satellite_campaign(trials=trials, seed=seed, output=output), as_json)


@campaign.command('papers')
@click.option('--trials', type=click.IntRange(1), help='Trials of each campaign.  [default: as '
              'many as the bounds of each need]')
@click.option('--only', multiple=True, help='Campaigns to run, by name; the page has the kept '
              'results of the others.')
@click.option('-o', '--output', type=click.Path(path_type=Path, file_okay=False), default='papers',
              callback=check_pictures, show_default=True,
              help='Folder for the page, the results and the pictures.')
@scheduler_option
@seed_option
@json_option
def campaign_papers(trials: int | None, only: tuple[str, ...], output: Path, scheduler: str,
                    seed: int, as_json: bool) -> None:
    """Run all campaigns of papers; write a page of every table, figure and claim."""
    from startracker_ros.evaluation.campaign.centroid import DataError
    from startracker_ros.evaluation.campaign.papers import CAMPAIGNS, run_papers_campaign
    check_names('campaign', only, CAMPAIGNS)
    with exit_1_on(DataError, output=output):
        result = run_papers_campaign(output, seed=seed, trials=trials, only=only,
                                     scheduler=scheduler)
    finish(result, as_json)


@campaign.command('integrity')
@trials_option(15, 'Runs in each condition, of 400 frames of centroids or 60 images.')
@click.option('--only', multiple=True, help='Conditions to run, by name.')
@scheduler_option
@seed_option
@json_option
def campaign_integrity(trials: int, only: tuple[str, ...], scheduler: str, seed: int,
                       as_json: bool) -> None:
    """Wrong attitudes counted in slews, darkness, false stars, wrong gyros, artefacts."""
    from startracker_ros.evaluation.campaign.integrity import (
        ALL_CONDITIONS, run_integrity_campaign)
    check_names('condition', only, ALL_CONDITIONS)
    finish(run_integrity_campaign(trials=trials, seed=seed, only=only, scheduler=scheduler),
           as_json)


@campaign.command('protection')
@trials_option(4000, 'Draws of each hypothesis and axis.', least=100)
@seed_option
@json_option
def campaign_protection(trials: int, seed: int, as_json: bool) -> None:
    """Exceed the protection level of an attitude, by importance sampling."""
    from startracker_ros.evaluation.campaign.protection import run_protection_campaign
    finish(run_protection_campaign(trials=trials, seed=seed), as_json)


@campaign.command('closed-loop')
@trials_option(100, 'Runs of 20 minutes with faults; fewer of the other conditions.')
@click.option('--only', multiple=True, help='Conditions to run, by name.')
@scheduler_option
@seed_option
@json_option
def campaign_closed_loop(trials: int, only: tuple[str, ...], scheduler: str, seed: int,
                         as_json: bool) -> None:
    """Control a spacecraft of Basilisk from tumbling to fine pointing, with faults."""
    from startracker_ros.evaluation.campaign.closed_loop import (
        CONDITIONS, run_closed_loop_campaign)
    check_names('condition', only, CONDITIONS)
    finish(run_closed_loop_campaign(trials=trials, seed=seed, only=only, scheduler=scheduler),
           as_json)


@campaign.command('faults')
@click.option('--only', multiple=True, help='Faults to do, by name.')
@seed_option
@json_option
def campaign_faults(only: tuple[str, ...], seed: int, as_json: bool) -> None:
    """Kill and stop processes, send bad images, clocks and disks: see how the nodes recover."""
    from startracker_ros.evaluation.campaign.faults import NAMES, run_faults_campaign
    from startracker_ros.ros.processes import HarnessError
    check_names('fault', only, NAMES)
    with exit_1_on(HarnessError):
        result = run_faults_campaign(seed=seed, only=only)
    finish(result, as_json)


@campaign.command('lifecycle')
@trials_option(1000, 'Sequences of four random transitions in each mode.')
@click.option('--only', multiple=True, help='Modes to run, by name: composed, processes.')
@seed_option
@json_option
def campaign_lifecycle(trials: int, only: tuple[str, ...], seed: int, as_json: bool) -> None:
    """Configure, activate, deactivate and clean up the nodes at random: they always return."""
    from startracker_ros.evaluation.campaign.lifecycle import MODES, run_lifecycle_campaign
    from startracker_ros.ros.processes import HarnessError
    check_names('mode', only, MODES)
    with exit_1_on(HarnessError):
        result = run_lifecycle_campaign(trials=trials, seed=seed, only=only)
    finish(result, as_json)


@campaign.command('full-frame')
@trials_option(5, 'Chips, of ten images each.')
@seed_option
@json_option
def campaign_full_frame(trials: int, seed: int, as_json: bool) -> None:
    """Calibrate a survey camera with SIP distortion and saturated stars, a twin of TESS."""
    from startracker_ros.evaluation.campaign.full_frame import run_full_frame_campaign
    finish(run_full_frame_campaign(trials=trials, seed=seed), as_json)


@campaign.command('soak')
@click.option('--frames', type=click.IntRange(500), default=100_000, show_default=True,
              help='Frames to send.')
@seed_option
@json_option
def campaign_soak(frames: int, seed: int, as_json: bool) -> None:
    """Many frames through the nodes: memory, handles, processor time and latency stay flat."""
    from startracker_ros.evaluation.campaign.soak import run_soak_campaign
    from startracker_ros.ros.processes import HarnessError
    with exit_1_on(HarnessError):
        result = run_soak_campaign(frames=frames, seed=seed)
    finish(result, as_json)


@campaign.command('centroid')
@click.option('--images', 'folder', metavar='FOLDER',
              type=click.Path(path_type=Path, exists=True, file_okay=False),
              help='Images with a solutions.csv.  [default: night-sky-11deg of STARTRACKER_DATA]')
@trials_option(200, 'Draws of images, with repetition.')
@picture_option('the scatter over the threshold')
@seed_option
@json_option
def campaign_centroid(folder: Path | None, trials: int, output: Path | None, seed: int,
                      as_json: bool) -> None:
    """Weighted means at right and wrong thresholds on real photographs."""
    from startracker_ros.evaluation.campaign.centroid import DataError, run_centroid_campaign
    with exit_1_on(DataError):
        result = run_centroid_campaign(folder, trials=trials, seed=seed, output=output)
    finish(result, as_json)


@campaign.command('lenses')
@trials_option(200, 'Fields, each of a lens of its own.')
@scheduler_option
@seed_option
@json_option
def campaign_lenses(trials: int, scheduler: str, seed: int, as_json: bool) -> None:
    """Star lists of uncalibrated lenses of 5 to 70 deg, solved with the field of view alone."""
    from startracker_ros.evaluation.campaign.lenses import run_lenses_campaign
    finish(run_lenses_campaign(trials=trials, seed=seed, scheduler=scheduler), as_json)


@campaign.command('heads')
@trials_option(50, 'Runs of 2000 frames for each figure, a 25th of them for learning mounts.')
@click.option('--only', multiple=True, help='Tasks to run, by name.')
@scheduler_option
@seed_option
@json_option
def campaign_heads(trials: int, only: tuple[str, ...], scheduler: str, seed: int,
                   as_json: bool) -> None:
    """Several heads fused: bounds, consistency, mounts learnt in flight, faulty heads."""
    from startracker_ros.evaluation.campaign.heads import run_heads_campaign, TASKS
    check_names('task', only, TASKS)
    finish(run_heads_campaign(trials=trials, seed=seed, only=only, scheduler=scheduler), as_json)
