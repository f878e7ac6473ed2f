# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The soak: memory, handles, processor time and latency over many frames."""

import numpy as np
from startracker_evaluation.campaign.resources import (
    growth, growth_rows, ResourceRow, tenths, WARM_UP)
from startracker_evaluation.harness.soak import (
    BAG_FILE_MB, CAMERA, IN_FLIGHT, NODES, Soak, SoakResult)
from startracker_ros.io.table import Result
from startracker_ros.ros.rig import LogFolder

FRAMES = 100_000
_GROWTH_MIB = 2.0
_LATER = 1.2


def rows_of(result: SoakResult) -> list[ResourceRow]:
    """Return the figures of a run, each with its bound."""
    count = len(result.sampled_frames)
    warm = slice(min(int(np.ceil(WARM_UP * count)), count - 2), None)
    frames = result.sampled_frames[warm]
    rows = [
        ResourceRow('frames', result.frames, unit='frames'),
        ResourceRow('frames without answer', result.lost, unit='frames', exactly=0),
        ResourceRow('frames with attitude', 100 * result.attitudes / result.frames, unit='%',
                    least=99),
        ResourceRow('wrong attitudes', result.wrong, unit='frames', exactly=0),
        ResourceRow('gross attitudes', result.gross, unit='frames', exactly=0),
        ResourceRow('pace', result.frames / result.elapsed_s, unit='frames/s')]
    latency_ms = 1e3 * np.array(result.latency_s)[int(WARM_UP * result.processed):]
    rows.append(_later_row('image sent to attitude received, last tenth', latency_ms))
    for node in NODES:
        samples = result.samples[node][warm]
        private = [sample.private_mib for sample in samples]
        slope, error = growth(np.array(frames) / FRAMES, private)
        rows += [
            ResourceRow(f'{node}: memory at the end', private[-1], unit='MiB'),
            ResourceRow(f'{node}: growth in 100,000 frames', slope, error, 'MiB',
                        f'<= {_GROWTH_MIB:g}', slope + error <= _GROWTH_MIB),
            *growth_rows(node, samples),
            _later_row(f'{node}: CPU time a frame, last tenth', 1e3 * np.diff(
                [sample.cpu_s for sample in samples]) / np.maximum(np.diff(frames), 1))]
    shared = result.shared_mib[warm]
    rows.append(ResourceRow('shared memory, growth', shared[-1] - shared[0], unit='MiB',
                            exactly=0))
    return rows


def _later_row(case: str, times_ms: np.ndarray) -> ResourceRow:
    """Return the median of the last tenth of times, bounded by that of the first."""
    first_ms, last_ms = tenths(times_ms)
    return ResourceRow(case, last_ms, unit='ms', bound=f'<= {_LATER:g} x {first_ms:.3g}',
                       holds=last_ms <= _LATER * first_ms)


def run_soak_campaign(*, frames: int, seed: int) -> Result:
    """Send the frames through the nodes; HarnessError when these do not work."""
    with LogFolder('soak') as folder, Soak(folder, seed=seed) as soak:
        result = soak.run(frames)
    return Result('campaign soak', rows_of(result), {
        'pipeline': f'four stages and a recorder, a process each; images of {CAMERA.width} x '
                    f'{CAMERA.height} px, stamps of 10 Hz, sent as fast as processed, '
                    f'{IN_FLIGHT} in flight',
        'recorder': f'all topics but the images, files of {BAG_FILE_MB:g} MB',
        'times': 'medians of the last tenth of the run, compared with those of the first',
        'memory': 'private pages of the process; growth by a straight line after the first '
                  'tenth of the run, error 2 sigma; the sum of growth and error is bounded',
        'seed': seed})
