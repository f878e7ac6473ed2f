"""The soak: memory, handles, processor time and latency over many frames."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from startracker_ros.harness.rig import LogFolder
from startracker_ros.harness.soak import BAG_FILE_MB, CAMERA, IN_FLIGHT, NODES, Soak, SoakResult
from startracker_ros.table import Result

FRAMES = 100_000
_WARM_UP = 0.1
_GROWTH_MIB = 2.0
_LATER = 1.2


@dataclass(frozen=True)
class SoakRow:
    """A figure of a run; error is 2 sigma."""

    case: str
    ours: float
    error: float | None
    unit: str
    bound: str
    holds: bool


def growth(frames: Sequence[int], values: Sequence[float]) -> tuple[float, float]:
    """
    Return the slope of values per 100,000 frames and its error, 2 sigma.

    Neighbouring samples are not independent: the error is that of the means of ten blocks.
    """
    x, y = np.asarray(frames) / 1e5, np.asarray(values)
    blocks = [block for block in np.array_split(np.arange(len(x)), 10) if len(block)]
    x, y = (np.array([part[block].mean() for block in blocks]) for part in (x, y))
    x = x - x.mean()
    slope = x @ (y - y.mean()) / (x @ x)
    residual = y - y.mean() - slope * x
    sigma = np.sqrt(residual @ residual / max(len(x) - 2, 1) / (x @ x))
    return float(slope), float(2 * sigma)


def _row(case: str, ours: float, unit: str, bound: str = '', holds: bool = True,
         error: float | None = None) -> SoakRow:
    return SoakRow(case, ours, error, unit, bound, holds)


def _tenths(values: Sequence[float] | np.ndarray) -> tuple[float, float]:
    """Return the medians of the first tenth and of the last."""
    tenth = max(len(values) // 10, 1)
    return float(np.median(values[:tenth])), float(np.median(values[-tenth:]))


def rows_of(result: SoakResult) -> list[SoakRow]:
    """Return the figures of a run, each with its bound."""
    count = len(result.sampled_frames)
    warm = slice(min(int(np.ceil(_WARM_UP * count)), count - 2), None)
    frames = result.sampled_frames[warm]
    rows = [
        _row('frames', result.frames, 'frames'),
        _row('frames without answer', result.lost, 'frames', '= 0', result.lost == 0),
        _row('frames with attitude', 100 * result.attitudes / result.frames, '%', '>= 99',
             result.attitudes >= 0.99 * result.frames),
        _row('wrong attitudes', result.wrong, 'frames', '= 0', result.wrong == 0),
        _row('pace', result.frames / result.elapsed_s, 'frames/s')]
    latency_ms = 1e3 * np.array(result.latency_s)[int(_WARM_UP * result.processed):]
    first, last = _tenths(latency_ms)
    rows.append(_row('image sent to attitude received, last tenth', last, 'ms',
                     f'<= {_LATER:g} x {first:.3g}', last <= _LATER * first))
    for node in NODES:
        samples = result.samples[node][warm]
        private = [sample.private_mib for sample in samples]
        slope, error = growth(frames, private)
        rows += [
            _row(f'{node}: memory at the end', private[-1], 'MiB'),
            _row(f'{node}: growth in 100,000 frames', slope, 'MiB', f'<= {_GROWTH_MIB:g}',
                 slope + error <= _GROWTH_MIB, error),
            *(_growth_row(node, name, [getattr(sample, name) for sample in samples])
              for name in ('handles', 'threads')),
            _cpu_row(node, frames, [sample.cpu_s for sample in samples])]
    shared = result.shared_mib[warm]
    rows.append(_row('shared memory, growth', shared[-1] - shared[0], 'MiB', '= 0',
                     shared[-1] == shared[0]))
    return rows


def _growth_row(node: str, name: str, counts: list[int]) -> SoakRow:
    first, last = _tenths(counts)
    return _row(f'{node}: {name}, growth', last - first, name, '= 0', last <= first)


def _cpu_row(node: str, frames: Sequence[int], cpu_s: list[float]) -> SoakRow:
    first_ms, last_ms = _tenths(1e3 * np.diff(cpu_s) / np.maximum(np.diff(frames), 1))
    return _row(f'{node}: CPU time a frame, last tenth', last_ms, 'ms',
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
