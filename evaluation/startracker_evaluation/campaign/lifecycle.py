# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Random transitions of managed nodes: no crash, no leak, no wrong attitude, a fast return."""

from dataclasses import replace

import numpy as np
from startracker_evaluation.campaign.resources import growth, growth_rows, ResourceRow
from startracker_evaluation.harness.random_transitions import (
    ANOTHER_SKY, CLEANED_UP, DEACTIVATED, LONGEST_PAUSE_S, RandomTransitions, SKY, TRANSITIONS,
    TransitionsResult)
from startracker_ros.io.table import Result
from startracker_ros.ros.rig import LogFolder
from startracker_ros.tools.figures.correctness import WRONG_TEXT

MODES = ('composed', 'processes')
SEQUENCES = 1000
_GROWTH_MIB = 10.0
# Each stage reaches its largest use of memory after some of its rebuilds.
_WARM_UP = 0.5
_REACTIVATION_S = 0.5
_AFTER = {DEACTIVATED: 'deactivate', CLEANED_UP: 'cleanup',
          ANOTHER_SKY: 'cleanup of the simulator'}


def rows_of(mode: str, result: TransitionsResult) -> list[ResourceRow]:
    """Return the figures of a run, each with its bound."""
    rows = [
        ResourceRow('sequences', result.sequences, unit='sequences'),
        ResourceRow('transitions requested', result.requests, unit='requests'),
        ResourceRow('responses and states that the lifecycle has not', result.wrong_responses,
                    unit='requests', exactly=0),
        ResourceRow('processes ended', len(result.ended), unit='processes', exactly=0),
        ResourceRow('attitudes', result.attitudes, unit='frames'),
        ResourceRow('wrong attitudes', result.wrong, unit='frames', exactly=0),
        ResourceRow('gross attitudes', result.gross, unit='frames', exactly=0),
        ResourceRow('attitudes without a truth received', result.unverified, unit='frames',
                    exactly=0)]
    for kind, times_s in result.reactivation_s.items():
        if times_s:
            rows += _reactivation_rows(kind, times_s)
    for process, samples in result.samples.items():
        warm = samples[int(_WARM_UP * len(samples)):]
        private = [sample.private_mib for sample in warm]
        rows += [
            ResourceRow(f'{process}: memory at the begin', samples[0].private_mib, unit='MiB'),
            ResourceRow(f'{process}: memory at the end', private[-1], unit='MiB')]
        if len(warm) > 1:
            slope, error = growth(np.arange(len(warm)) / SEQUENCES, private)
            rows.append(ResourceRow(
                f'{process}: growth in {SEQUENCES} sequences', slope, error, 'MiB',
                f'<= {_GROWTH_MIB:g}', slope - error <= _GROWTH_MIB))
        rows += growth_rows(process, warm)
    return [replace(row, case=f'{mode}: {row.case}') for row in rows]


def _reactivation_rows(kind: str, times_s: list[float]) -> list[ResourceRow]:
    """Return the median and the largest time; after another sky no bound is asked for."""
    after = f'activate to attitude after {_AFTER[kind]}'
    return [ResourceRow(f'{after}, p50 of {len(times_s)}', float(np.median(times_s)), unit='s'),
            ResourceRow(f'{after}, largest', max(times_s), unit='s',
                        most=None if kind == ANOTHER_SKY else _REACTIVATION_S)]


def run_lifecycle_campaign(*, trials: int, seed: int, only: tuple[str, ...] = ()) -> Result:
    """Run sequences in each mode; HarnessError when the nodes do not work."""
    rows: list[ResourceRow] = []
    logs = LogFolder('lifecycle')
    with logs as folder:
        for mode in only or MODES:
            (folder / mode).mkdir()
            with RandomTransitions(folder / mode, composed=mode == 'composed', seed=seed) as run:
                rows += rows_of(mode, run.run(trials))
        logs.keep = not all(row.holds for row in rows)
    return Result('campaign lifecycle', rows, {
        'pipeline': f'four stages and a simulator of {SKY["width"]} x {SKY["height"]} px, '
                    f'{SKY["frame_rate_hz"]:g} Hz, turning at 0.11 deg/s',
        'sequence': f'{TRANSITIONS} random transitions of random nodes, possible and impossible '
                    f'ones, up to {LONGEST_PAUSE_S:g} s apart; then all nodes are activated',
        'activate to attitude': 'from the request of the last activation, where a node was not '
                                'active; cleanup: some stage was unconfigured in the sequence; '
                                'cleanup of the simulator: it begins with another attitude',
        'wrong': WRONG_TEXT,
        'memory': 'private pages of each process after each sequence; growth by a straight line '
                  'after the first half of the run, error 2 sigma; their difference is bounded',
        **({'logs': str(logs.path)} if logs.keep else {}), 'seed': seed})
