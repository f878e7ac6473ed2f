# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The group campaign: published tables repeated, long runs."""

from functools import partial
from pathlib import Path

import click
from startracker_evaluation.cli.measurement import HARNESS, measurement, only_option
from startracker_ros.tools.cli.outcome import Commands, exit_1_on, InputPath
from startracker_ros.tools.cli.shared import (
    check_names, check_pictures, finish_measured as finish, json_option, picture_option,
    scheduler_option, seed_option, trials_option)


@click.group(cls=Commands)
def campaign() -> None:
    """Repeat the published tables: the paper's figure, and ours."""


@campaign.command('papers')
@click.option('--trials', type=click.IntRange(1), metavar='N',
              help='Trials of each campaign.  [default: as many as the bounds of each need]')
@click.option('--only', multiple=True, metavar='NAME',
              help='Campaigns to run, by name; the page has the kept results of the others.')
@click.option('-o', '--output', type=click.Path(path_type=Path, file_okay=False), default='papers',
              callback=check_pictures, show_default=True,
              help='Folder for the page, the results and the pictures.')
@scheduler_option
@seed_option
@json_option
def campaign_papers(trials: int | None, only: tuple[str, ...], output: Path, scheduler: str,
                    seed: int, as_json: bool) -> None:
    """Run all campaigns of papers; write a page of every table, figure and claim."""
    from startracker_evaluation.campaign.centroid import DataError
    from startracker_evaluation.campaign.papers import CAMPAIGNS, run_papers_campaign
    check_names('campaign', only, CAMPAIGNS)
    with exit_1_on(DataError, output=output):
        result = run_papers_campaign(output, seed=seed, trials=trials, only=only,
                                     scheduler=scheduler)
    finish(result, as_json)


_campaign = partial(measurement, campaign)

_campaign('hausdorff', 'campaign.hausdorff:run_hausdorff_campaign',
          'Find sets of bright stars by their Hausdorff distance in a field of 12 deg.',
          trials_option(200, 'Directions of each figure.'), picture_option('the times'),
          scheduler_option)
_campaign('quad', 'campaign.quad:run_quad_campaign',
          'Quads of stars found by k-vector in a field of 20.3 deg.',
          trials_option(300, 'Frames along the orbit, and as many of the whole sky.'),
          picture_option('the angles along the orbit'), scheduler_option)
_campaign('extended-grid', 'campaign.extended_grid:run_extended_grid_campaign',
          'Fields of 4 deg with few stars, known by a gyro and grids beyond the edge.',
          trials_option(10_000, 'Directions of each figure.'),
          picture_option('each figure of the paper'), scheduler_option)
_campaign('jpdaf', 'campaign.jpdaf:run_jpdaf_campaign',
          'Four stars tracked by JPDAF through turns, straight lines and jitter.',
          trials_option(100, 'Runs of 400 frames in each cell.'),
          picture_option('the figures of the paper'), scheduler_option)
_campaign('two-satellite', 'campaign.two_satellite:run_two_satellite_campaign',
          'Locate a target by the cameras of two satellites under four sources of error.',
          trials_option(100_000, 'Draws of the figures beyond the 500 of the paper.', least=1000),
          picture_option('the errors'))
_campaign('integrity', 'campaign.integrity:run_integrity_campaign',
          'Wrong attitudes counted in slews, darkness, false stars, wrong gyros, artefacts.',
          trials_option(15, 'Runs of 100 images in each condition; five or seven times as many '
                        'of lists.'),
          only_option('Conditions'), scheduler_option, known='ALL_CONDITIONS', kind='condition')
_campaign('protection', 'campaign.protection:run_protection_campaign',
          'Exceed the protection level of an attitude, by importance sampling.',
          trials_option(4000, 'Draws of each hypothesis and axis.', least=100))
_campaign('closed-loop', 'campaign.closed_loop:run_closed_loop_campaign',
          'Control a spacecraft of Basilisk from tumbling to fine pointing, with faults.',
          trials_option(100, 'Runs of 20 minutes with faults; fewer of the other conditions.'),
          only_option('Conditions'), scheduler_option, known='CONDITIONS', kind='condition')
_campaign('faults', 'campaign.faults:run_faults_campaign',
          'Kill and stop processes, send bad images, clocks and disks: see how the nodes recover.',
          click.option('--only', multiple=True, metavar='NAME',
                       help='Faults to do, by name.'),
          known='NAMES', kind='fault', error=HARNESS)
_campaign('lifecycle', 'campaign.lifecycle:run_lifecycle_campaign',
          'Configure, activate, deactivate and clean up the nodes at random: they always return.',
          trials_option(1000, 'Sequences of four random transitions in each mode.'),
          click.option('--only', multiple=True, metavar='NAME',
                       help='Modes to run, by name: composed, processes.'),
          known='MODES', kind='mode', error=HARNESS)
_campaign('full-frame', 'campaign.full_frame:run_full_frame_campaign',
          'Calibrate a survey camera with SIP distortion and saturated stars, a twin of TESS.',
          trials_option(5, 'Chips, of ten images each.'))
_campaign('soak', 'campaign.soak:run_soak_campaign',
          'Many frames through the nodes: memory, handles, processor time and latency stay flat.',
          click.option('--frames', type=click.IntRange(500), default=100_000, show_default=True,
                       metavar='N', help='Frames to send.'), error=HARNESS)
_campaign('centroid', 'campaign.centroid:run_centroid_campaign',
          'Weighted means at right and wrong thresholds on real photographs.',
          click.option('--images', 'folder', metavar='FOLDER',
                       type=InputPath(file_okay=False),
                       help='Images with a solutions.csv.  '
                       '[default: night-sky-11deg of STARTRACKER_DATA]'),
          trials_option(200, 'Draws of images, with repetition.'),
          picture_option('the scatter over the threshold'),
          error='startracker_evaluation.campaign.centroid:DataError')
_campaign('lenses', 'campaign.lenses:run_lenses_campaign',
          'Star lists of uncalibrated lenses of 5 to 70 deg, solved with the field of view alone.',
          trials_option(200, 'Fields, each of a lens of its own.'), scheduler_option)
_campaign('fisheyes', 'campaign.fisheyes:run_fisheyes_campaign',
          'Star lists of fisheyes and cropped images of which nothing is known, and of no sky.',
          trials_option(200, 'Nights of each kind of lens, lists of each kind without a sky.'),
          only_option('Kinds'),
          scheduler_option, known='KINDS', kind='kind')
_campaign('sub-frames', 'campaign.sub_frames:run_sub_frames_campaign',
          'Attitudes at 160 Hz out of frames at 10 Hz of a rolling shutter, and their bound.',
          trials_option(40, 'Runs of 120 frames of each motion.'), scheduler_option)
_campaign('heads', 'campaign.heads:run_heads_campaign',
          'Several heads fused: bounds, consistency, mounts estimated in flight, faulty heads.',
          trials_option(50, 'Runs of 2000 frames for each figure, a 25th of them for learning '
                        'mounts.'),
          only_option('Tasks'), scheduler_option, known='TASKS', kind='task')
