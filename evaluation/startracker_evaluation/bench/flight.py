# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
What the native core takes of a flight computer: memory, code, stack, worst frame, instructions.

It is compiled from native in the current folder, a source tree. Instructions are counted by
qemu-user with native/test/count_instructions.c: rows of x86-64 need qemu-x86_64, those of aarch64
qemu-aarch64 and g++ for it (Debian: qemu-user, g++-aarch64-linux-gnu). The stack is that of
painted memory in runs, and by the call graph of g++ for all calls that are possible.
"""

from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
import ctypes
from functools import cache
import os
from pathlib import Path
import re
import runpy
import shutil
import subprocess
import tempfile
from typing import Any

import numpy as np
from startracker_ros.core import native
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.stars import load_catalog
from startracker_ros.core.identify.sky_file import sky_arrays
from startracker_ros.core.stored_arrays import write_arrays
from startracker_ros.io.table import Result
from startracker_ros.sim.sky.detector import DetectorOptions
from startracker_ros.sim.sky.motion import motion_from_options, MotionOptions
from startracker_ros.sim.sky.simulator import SkySimulator
from startracker_ros.tools.figures.machine import machine, MachineLoad, origin
from startracker_ros.tools.figures.rows import Row

YEAR = 2026.0
CAMERA = Camera.from_fov(1024, 1024, 12.0)
MOST_STACK_KIB = 256.0
_MIB = 2 ** 20
_STAGES = {'extraction': 1, 'identification': 2, 'tracking': 4, 'trust': 8, 'all stages': 15}
_CONFIGURATIONS: Mapping[str, tuple[int, float, dict[str, int]]] = {
    '512 px, 12 deg': (512, 12.0, {}), '1024 px, 20 deg': (1024, 20.0, {}),
    '2048 px, 12 deg': (2048, 12.0, {}),
    '1024 px, 12 deg, 16 tracks, 200 centroids, 8 frames': (
        1024, 12.0, {'tracks': 16, 'centroids': 200, 'frames': 8})}
_PERIOD_NS = 100_000_000
_OBJECTS = Path('build', 'native')
_PROCESSORS = {'x86-64': ('qemu-x86_64', 'g++', ('-cpu', 'max')),
               'aarch64': ('qemu-aarch64', 'aarch64-linux-gnu-g++',
                           ('-L', '/usr/aarch64-linux-gnu'))}
_FRAMES = {'lost': 'st_process_image, lost', 'whole': 'st_process_image, tracking, whole image',
           'windowed': 'st_process_image, tracking, predicted stars',
           'spots': 'st_process_image, lost, image full of false stars',
           'slices': 'st_process_image, lost, image full of false stars, slice_s 0.02'}
_SLICE_S = 0.02


@cache
def _build() -> dict[str, Any]:
    return runpy.run_path('native/build.py')


def _compiler(processor: str) -> Any:
    """Return the compiler for a processor, None where there is none."""
    name = _PROCESSORS[processor][1]
    return _build()['find_compiler']({**os.environ, 'CXX': name}) if shutil.which(name) else None


# --- memory ---


def _sky(camera: Camera, folder: Path) -> Path:
    path = folder / f'{camera.width}-{camera.pixel_rad:.3e}.sky'
    if not path.exists():
        with path.open('w+b') as file:
            write_arrays(file, sky_arrays(camera, YEAR))
    return path


def tracker_bytes(camera: Camera, sky: Path, stages: int, capacities: Mapping[str, int]) -> int:
    """Return what st_size() says."""
    config, size = native.defaults(), ctypes.c_size_t()
    config['stages'] = stages
    for name, value in capacities.items():
        config['capacities'][name] = value
    file = np.memmap(sky, np.uint8, 'r')
    given = (config, camera.native, np.array((file.ctypes.data, len(file)), native.SKY))
    native.check(native.library().st_size(*(one.ctypes.data for one in given),
                                          ctypes.byref(size)))
    return size.value


def _memory(folder: Path) -> Iterator[Row]:
    sky = _sky(CAMERA, folder)
    for name, stages in _STAGES.items():
        yield Row(f'memory, 1024 px, 12 deg: {name}',
                  tracker_bytes(CAMERA, sky, stages, {}) / _MIB, unit='MiB')
    for name, (size, fov_deg, capacities) in _CONFIGURATIONS.items():
        camera = Camera.from_fov(size, size, fov_deg)
        yield Row(f'memory, {name}: all stages', tracker_bytes(
            camera, _sky(camera, folder), 15, capacities) / _MIB, unit='MiB')
    yield Row('memory, st_result', native.RESULT.itemsize / 1024, unit='KiB')
    yield Row('memory, sky file of 1024 px, 12 deg, read only', sky.stat().st_size / _MIB,
              unit='MiB')


# --- frames ---


def _recordings(frames: int, seed: int, folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield recordings for native/test/flight.c: a turning camera, and images of false stars."""
    rng = np.random.default_rng(seed)
    simulator = SkySimulator(
        CAMERA, motion_from_options(MotionOptions(motion='constant_rate')), load_catalog(), YEAR,
        detector_options=DetectorOptions(bit_depth=16), seed=seed)
    clean = [simulator.frame(number * _PERIOD_NS * 1e-9).image for number in range(frames)]
    spots = [_with_spots(image, rng) for image in clean[:10]]
    for name, images in (('sky', clean), ('spots', spots), ('slices', spots)):
        path, config = folder / name, native.defaults()
        config['identification']['slice_s'] = _SLICE_S if name == 'slices' else 0.0
        with path.open('wb') as file:
            file.write(config.tobytes() + CAMERA.native.tobytes()
                       + np.array([1, len(images)], np.int32).tobytes())
            for number, image in enumerate(images):
                file.write(np.int64((number + 1) * _PERIOD_NS).tobytes()
                           + np.ascontiguousarray(image, np.uint16).tobytes())
        yield name, path


def _with_spots(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return an image with ten thousand false stars, other ones in each."""
    spots = np.zeros(image.shape)
    spots[tuple(rng.integers(3, CAMERA.width - 3, (2, 10_000)))] = rng.uniform(500, 60_000, 10_000)
    weight = np.exp(-0.5 * np.arange(-2, 3) ** 2)
    for axis in (0, 1):
        spots = np.apply_along_axis(np.convolve, axis, spots, weight / weight.sum(), 'same')
    return np.minimum(image + spots, 65535).astype(np.uint16)


def program(processor: str, folder: Path) -> Path | None:
    """Return native/test/flight.c compiled for a processor, None where no compiler is there."""
    compiler = _compiler(processor)
    if compiler is None:
        return None
    target = folder / f'flight-{processor}'
    _build()['build'](_build()['runner']('flight', compiler), target, _OBJECTS, compiler)
    return target


def run(command: list[str], sky: Path, recording: Path) -> dict[str, np.ndarray]:
    """Return of each frame of a recording its kind, ns, and bytes of stack."""
    done = subprocess.run([*command, str(sky), str(recording)], text=True, capture_output=True,
                          check=True)
    rows = np.array([line.split() for line in done.stdout.splitlines()], np.int64)
    kinds = np.where(rows[:, 2] == 1, 'windowed', np.where(rows[:, 3] == 2, 'whole', 'lost'))
    if recording.name != 'sky':
        kinds = np.full(len(rows), recording.name)
    return {'kind': kinds, 'ns': rows[:, 0], 'stack': rows[:, 1]}


def _instructions(processor: str, sky: Path, recordings: Mapping[str, Path], folder: Path
                  ) -> dict[str, int]:
    """Return the most instructions of a frame of each kind; nothing without qemu."""
    emulator, _, options = _PROCESSORS[processor]
    target = program(processor, folder)
    if target is None or shutil.which(emulator) is None:
        return {}
    plugin, log = folder / 'count_instructions.so', folder / 'instructions'
    subprocess.run(['cc', '-O2', '-shared', '-fPIC', 'native/test/count_instructions.c', '-o',
                    plugin], check=True)
    most: dict[str, int] = {}
    for recording in recordings.values():
        frames = run([emulator, *options, '-d', 'plugin', '-D', str(log), '-plugin', str(plugin),
                      str(target)], sky, recording)
        taken = np.diff(np.array(log.read_text().split(), np.int64).reshape(-1, 2))[:, 0]
        for kind in set(frames['kind']):
            most[kind] = int(taken[frames['kind'] == kind].max())
    return most


def _frames(frames: int, seed: int, folder: Path) -> Iterator[Row]:
    sky, recordings = _sky(CAMERA, folder), dict(_recordings(frames, seed, folder))
    target = program('x86-64', folder)
    assert target is not None
    found = [run([str(target)], sky, path) for path in recordings.values()]
    kind, ns, stack = (np.concatenate([one[name] for one in found])
                       for name in ('kind', 'ns', 'stack'))
    counts = {name: _instructions(name, sky, recordings, folder) for name in _PROCESSORS}
    for name, text in _FRAMES.items():
        of = kind == name
        yield Row(f'frame, {text}: median', np.median(ns[of]) * 1e-6, unit='ms')
        yield Row(f'frame, {text}: worst of {of.sum()}', ns[of].max() * 1e-6, unit='ms')
        for processor, most in counts.items():
            if name in most:
                yield Row(f'frame, {text}: {processor}', most[name] * 1e-6,
                          unit='million instructions')
    yield Row('stack, painted, x86-64: all of these frames', stack.max() / 1024, unit='KiB',
              most=MOST_STACK_KIB)


# --- stack by the call graph ---


class CallGraph:
    """Bytes of the frame of each function, and what it calls; dynamic: without a bound."""

    def __init__(self) -> None:
        self.frame: dict[str, int] = {}
        self.called: dict[str, set[str]] = {}
        self.dynamic: set[str] = set()
        self._depth: dict[str, int] = {}

    def read(self, text: str) -> None:
        """Add the functions of a source, by what g++ -fcallgraph-info=su writes of it."""
        for title, label in re.findall(r'node: { title: "([^"]*)" label: "([^"]*)"', text):
            size = re.search(r'\\n(\d+) bytes \(([^)]*)\)', label)
            if size:
                self.frame[title] = int(size[1])
                if size[2] == 'dynamic':  # not 'dynamic,bounded', of what is aligned
                    self.dynamic.add(title)
        for caller, callee in re.findall(
                r'edge: { sourcename: "([^"]*)" targetname: "([^"]*)"', text):
            self.called.setdefault(caller, set()).add(callee)

    def deepest(self, function: str, above: tuple[str, ...] = ()) -> int:
        """Return the most bytes of a function and all below; ValueError where it is recursive."""
        if function in above:
            raise ValueError(f'{function} calls itself, by {above}')
        if function not in self._depth:
            self._depth[function] = self.frame.get(function, 0) + max(
                (self.deepest(name, (*above, function))
                 for name in self.called.get(function, ())), default=0)
        return self._depth[function]


def _call_graph(folder: Path) -> CallGraph:
    """Return the call graph of native/src."""
    build, compiler, graph = _build(), _compiler('x86-64'), CallGraph()

    def written(source: Path) -> str:
        target = folder / f'{source.parent.name}-{source.stem}.o'
        subprocess.run([*compiler.command, *compiler.processor, *build['_FLAGS'],
                        *build['_OF_SUFFIX'][source.suffix], '-DST_NO_CLONES',
                        '-fcallgraph-info=su', '-c', source, '-o', target], check=True)
        return target.with_suffix('.ci').read_text()

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for text in pool.map(written, build['_core']()):
            graph.read(text)
    return graph


def _stack(folder: Path) -> Iterator[Row]:
    graph = _call_graph(folder)
    for name in ('st_process_image', 'st_process_centroids', 'st_create', 'st_check_sky',
                 'st_fusion_create', 'st_fusion_add_frame'):
        yield Row(f'stack, call graph, x86-64: {name}', graph.deepest(name) / 1024, unit='KiB',
                  most=MOST_STACK_KIB)
    yield Row('stack, call graph: functions without a bound', len(graph.dynamic),
              unit='', exactly=0)
    yield Row('stack, call graph: calls by a pointer', sum(
        '__indirect_call' in called for called in graph.called.values()), unit='')


def _code(folder: Path) -> Iterator[Row]:
    for processor, (_, name, _) in _PROCESSORS.items():
        compiler, tool = _compiler(processor), shutil.which(name.replace('g++', 'size'))
        if compiler is None or tool is None:
            continue
        target = folder / f'code-{processor}.so'
        _build()['build'](_build()['library'](compiler), target, _OBJECTS, compiler)
        text, data, bss = map(int, subprocess.run(
            [tool, target], text=True, capture_output=True, check=True
        ).stdout.splitlines()[1].split()[:3])
        yield Row(f'code, {processor}: instructions and constants', text / 1024, unit='KiB')
        yield Row(f'code, {processor}: variables', (data + bss) / 1024, unit='KiB')


CASES = {'memory': lambda frames, seed, folder: _memory(folder), 'frame': _frames,
         'stack': lambda frames, seed, folder: _stack(folder),
         'code': lambda frames, seed, folder: _code(folder)}


def run_flight_bench(trials: int = 300, seed: int = 0, only: tuple[str, ...] = tuple(CASES)
                     ) -> Result:
    """Return what the core takes of a flight computer; trials are frames of the recording."""
    load = MachineLoad()
    with tempfile.TemporaryDirectory() as folder:
        rows = [row for name in only for row in CASES[name](trials, seed, Path(folder))]
    return Result('bench flight', rows, {
        'seed': seed, 'trials': trials, 'machine': machine(), 'load': str(load),
        'compiler': native.build_text(),
        'frames': '1024 px, 12 deg, 16 bits, 10 Hz, 0.06 deg/s, default options'},
        origin=origin())
