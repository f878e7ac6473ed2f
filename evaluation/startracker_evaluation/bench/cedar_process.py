# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
cedar-solve in a Python of its own, with the NumPy below 2 that it needs.

Run by path; imports nothing of this package:

    python cedar_process.py build CATALOGUE DATABASE FOV_DEG MAGNITUDE_LIMIT EPOCH_YEAR
    python cedar_process.py solve DATABASE FRAMES.npz RESULTS.npz
    python cedar_process.py detect IMAGE.npy STARS.npz

build prints seconds and MB. FRAMES has uv (N, 2) in px, (0, 0) the centre of the top-left
pixel, of all frames after one another, count (F,) of each, size_px (F, 2) height and width,
fov_deg (F,) and warm_up, the number of first frames without a result. RESULTS has pointing_deg
(F - warm_up, 3): right ascension, declination and roll in the convention of cedar-solve, NaN
without a solution; cpu_s (F - warm_up,). STARS has stars (N, 3) u, v, flux, and cpu_s.
"""

from collections.abc import Callable
import gc
import logging
from pathlib import Path
import sys
import time

import numpy as np

PATTERN_MAX_ERROR = 0.003
FOV_TOLERANCE = 0.05
TIME_LIMIT_MS = 1000


def measure(build: Callable[[], object]) -> tuple[object, float, float]:
    """Return the result of build(), its wall time in s and the growth of memory in MB."""
    # Linux counts the peak from here on.
    Path('/proc/self/clear_refs').write_text('5')
    before_mb = status_mb('VmRSS')
    start_s = time.perf_counter()
    built = build()
    return built, time.perf_counter() - start_s, status_mb('VmHWM') - before_mb


def status_mb(field: str) -> float:
    """Return a field of the status of this process, as VmHWM, the most memory so far (Linux)."""
    lines = Path('/proc/self/status').read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(field))


def _build(catalogue: str, database: str, fov_deg: str, magnitude_limit: str,
           epoch_year: str) -> None:
    import tetra3
    solver = tetra3.Tetra3(load_database=None)
    _, seconds, memory_mb = measure(lambda: solver.generate_database(
        max_fov=float(fov_deg), star_catalog=catalogue, save_as=database,
        star_max_magnitude=float(magnitude_limit), pattern_max_error=PATTERN_MAX_ERROR,
        epoch_proper_motion=float(epoch_year)))
    print(seconds, memory_mb)


def _solve(database: str, frames: str, results: str) -> None:
    import tetra3
    solver = tetra3.Tetra3(load_database=database)
    with np.load(frames) as inputs:
        fields = np.split(inputs['uv'], np.cumsum(inputs['count'])[:-1])
        sizes_px, fovs_deg = inputs['size_px'], inputs['fov_deg']
        warm_up = int(inputs['warm_up'])
    pointing_deg, cpu_s = [], []
    gc.disable()
    for uv, size_px, fov_deg in zip(fields, sizes_px, fovs_deg):
        # Rows of (y, x), (0, 0) the corner of the image.
        yx = uv[:, ::-1] + 0.5
        start_s = time.process_time()
        result = solver.solve_from_centroids(
            yx, tuple(map(int, size_px)), fov_estimate=fov_deg,
            fov_max_error=FOV_TOLERANCE * fov_deg,
            match_max_error=None, solve_timeout=TIME_LIMIT_MS)
        cpu_s.append(time.process_time() - start_s)
        solved = result['RA'] is not None
        pointing_deg.append([result['RA'], result['Dec'], result['Roll']] if solved
                            else [np.nan] * 3)
    np.savez(results, pointing_deg=np.array(pointing_deg)[warm_up:],
             cpu_s=np.array(cpu_s)[warm_up:])


def _detect(image_file: str, stars: str) -> None:
    from tetra3 import get_centroids_from_image
    image = np.load(image_file)
    get_centroids_from_image(image)
    start_s = time.process_time()
    yx, moments = get_centroids_from_image(image, return_moments=True)
    cpu_s = time.process_time() - start_s
    np.savez(stars, stars=np.column_stack([yx[:, ::-1] - 0.5, moments[0]]), cpu_s=cpu_s)


if __name__ == '__main__':
    logging.disable(logging.CRITICAL)
    commands: dict[str, Callable[..., None]] = {
        'build': _build, 'solve': _solve, 'detect': _detect}
    commands[sys.argv[1]](*sys.argv[2:])
