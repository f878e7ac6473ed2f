# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The soak: memory, handles, processor time and latency over many frames."""

from collections.abc import Sequence

import numpy as np
from startracker_ros.evaluation.campaign.resources import (
    bounded_row, BoundedRow, growth, growth_rows, tenths, WARM_UP)
from startracker_ros.evaluation.harness.soak import (
    BAG_FILE_MB, CAMERA, IN_FLIGHT, NODES, Soak, SoakResult)
from startracker_ros.io.table import Result
from startracker_ros.ros.rig import LogFolder

FRAMES = 100_000
_GROWTH_MIB = 2.0
_LATER = 1.2


def rows_of(result: SoakResult) -> list[BoundedRow]:
    """Return the figures of a run, each with its bound."""
    count = len(result.sampled_frames)
    warm = slice(min(int(np.ceil(WARM_UP * count)), count - 2), None)
    frames = result.sampled_frames[warm]
    rows = [
        bounded_row('frames', result.frames, 'frames'),
        bounded_row('frames without answer', result.lost, 'frames', '= 0', result.lost == 0),
        bounded_row('frames with attitude', 100 * result.attitudes / result.frames, '%', '>= 99',
                    result.attitudes >= 0.99 * result.frames),
        bounded_row('wrong attitudes', result.wrong, 'frames', '= 0', result.wrong == 0),
        bounded_row('gross attitudes', result.gross, 'frames', '= 0', result.gross == 0),
        bounded_row('pace', result.frames / result.elapsed_s, 'frames/s')]
    latency_ms = 1e3 * np.array(result.latency_s)[int(WARM_UP * result.processed):]
    first, last = tenths(latency_ms)
    rows.append(bounded_row('image sent to attitude received, last tenth', last, 'ms',
                            f'<= {_LATER:g} x {first:.3g}', last <= _LATER * first))
    for node in NODES:
        samples = result.samples[node][warm]
        private = [sample.private_mib for sample in samples]
        slope, error = growth(np.array(frames) / FRAMES, private)
        rows += [
            bounded_row(f'{node}: memory at the end', private[-1], 'MiB'),
            bounded_row(f'{node}: growth in 100,000 frames', slope, 'MiB', f'<= {_GROWTH_MIB:g}',
                        slope + error <= _GROWTH_MIB, error),
            *growth_rows(node, samples),
            _cpu_row(node, frames, [sample.cpu_s for sample in samples])]
    shared = result.shared_mib[warm]
    rows.append(bounded_row('shared memory, growth', shared[-1] - shared[0], 'MiB', '= 0',
                            shared[-1] == shared[0]))
    return rows


def _cpu_row(node: str, frames: Sequence[int], cpu_s: list[float]) -> BoundedRow:
    first_ms, last_ms = tenths(1e3 * np.diff(cpu_s) / np.maximum(np.diff(frames), 1))
    return bounded_row(f'{node}: CPU time a frame, last tenth', last_ms, 'ms',
                       f'<= {_LATER:g} x {first_ms:.3g}', last_ms <= _LATER * first_ms)


def run_soak_campaign(*, frames: int, seed: int) -> Result:
    """Send the frames through the nodes; HarnessError when these do not work."""
    with LogFolder('soak') as folder, Soak(folder, seed=seed) as soak:
        result = soak.run(frames)
    return Result('campaign soak', rows_of(result), {
        'pipeline': f'four stages and a recorder, a process each; images of {CAMERA.width} x '
                    f'{CAMERA.height} px, stamps of 10 Hz, sent as fast as processed, '
                    f'{IN_FLIGHT} in flight',
        'recorder': f'all topics but the images, files of {BAG_FILE_MB:g} MB',
        'times': 'medians of the last tenth of the run, beside those of the first',
        'memory': 'private pages of the process; growth by a straight line after the first '
                  'tenth of the run, error 2 sigma; the sum of growth and error is bounded',
        'seed': seed})
