# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Attitude of image files: extraction, identification, pointing."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from itertools import chain, count, islice
from pathlib import Path
import time
from typing import Any, NamedTuple

import cv2
import numpy as np
from startracker_ros.core.astro.observer_motion import Observer
from startracker_ros.core.camera.distortion import EQUIDISTANT, PLUMB_BOB
from startracker_ros.core.camera.model import Camera
from startracker_ros.core.catalog.apparent import ApparentCatalog
from startracker_ros.core.catalog.onboard import OnboardCatalog
from startracker_ros.core.centroid.centroids import Centroids
from startracker_ros.core.centroid.extraction import CentroidExtractor
from startracker_ros.core.identify.cache import camera_stars
from startracker_ros.core.identify.icrf import icrf_identification
from startracker_ros.core.identify.identification import IdentificationOptions, Identifier
from startracker_ros.core.identify.methods import make_identifier
from startracker_ros.core.stages.bodies import Bodies
from startracker_ros.core.stages.sky_mapping import SkyMapping
from startracker_ros.io.images.camera_files import is_wcs, load_camera
from startracker_ros.io.images.dark import Dark, read_dark
from startracker_ros.io.images.images import (
    camera_of, ideal_camera, ImageError, Photograph, read_photograph)
from startracker_ros.io.images.video import frames, is_video
from startracker_ros.io.images.wcs_file import read_wcs_camera
from startracker_ros.io.output import output_folder, write_output
from startracker_ros.io.progress import progress
from startracker_ros.io.several_files import OneOfSeveral
from startracker_ros.io.table import Result
from startracker_ros.photographs.deep_sky import check_deep_sky
from startracker_ros.photographs.epoch_and_site import Epoch, epoch_of, ObserverSite, OPTION
from startracker_ros.photographs.hot_clusters import without_clusters
from startracker_ros.photographs.photograph import PhotographSolver
from startracker_ros.photographs.same_camera import Known
from startracker_ros.photographs.searched_fields import HIGHEST_DEG
from startracker_ros.photographs.sequence import camera_key, CameraKey, ImageSequence
from startracker_ros.photographs.sip import wcs_header
from startracker_ros.photographs.solution import MIN_STARS, Solution
from startracker_ros.photographs.tiled import Place
from startracker_ros.photographs.tiles import TiledCatalogue

DETAILS = ('path', 'status', 'quaternion', 'covariance_sensor', 'false_alarm_probability',
           'detected', 'lens', 'lens_from', 'epoch', 'epoch_from', 'bodies', 'uncatalogued',
           'mirrored', 'frame', 'time_s', 'cpu_ms', 'written', 'not_written')
"""Columns that are too wide for the terminal."""

# What a person knows of the field of view of a photograph, and of a calibrated camera.
UNCALIBRATED_PERCENT, CALIBRATED_PERCENT = 5.0, 0.5
# Nobody flies by a photograph: on a busy machine it may take as long as its search needs.
PHOTOGRAPH_LIMIT_S = 1.0
_MOST_NAMED = 4
NEAR_DEG = 5.0
"""How far an image may be from the position that is given for it."""


class Shot(NamedTuple):
    """
    A photograph, or the reason why its file cannot be read.

    output is the name of what is written of it, frame its number in a video and time_s its time
    there, None for an image.
    """

    path: Path
    output: str
    photograph: Photograph | None = None
    error: str = ''
    frame: int | None = None
    time_s: float | None = None

    @property
    def label(self) -> str:
        """Return the name of the file, with the number of the frame of a video."""
        return self.path.name + ('' if self.frame is None else f'#{self.frame}')


def shots(paths: Iterable[Path], names: Iterable[str], selection: slice) -> Iterator[Shot]:
    """Yield the photographs of files, of videos the selected frames; names are of output."""
    for path, name in zip(paths, names):
        errors = list[str]()
        with OneOfSeveral(errors.append):
            if not is_video(path):
                yield Shot(path, name, read_photograph(path))
                continue
            number = None
            for number, time_s, image, taken in islice(
                    frames(path), selection.start, selection.stop, selection.step):
                yield Shot(path, f'{name}_frame{number:05d}', Photograph(image, taken=taken),
                           frame=number, time_s=time_s)
            if number is None:
                raise ImageError(f'{path}: --frames selects no frame of it')
        for error in errors:
            yield Shot(path, name, error=error)


def output_names(paths: Sequence[Path]) -> list[str]:
    """Return a name of the files for each image, numbered where several have the same."""
    names: dict[str, None] = {}
    for path in paths:
        numbered = (f'{path.stem}-{number}' for number in count(2))
        names[next(name for name in chain([path.stem], numbered) if name not in names)] = None
    return [*names]


def solve_image(image: np.ndarray, extractor: CentroidExtractor, identifier: Identifier,
                sky: ApparentCatalog, bodies: Bodies = Bodies()) -> Solution:
    """Return the attitude of one image (H, W) of a calibrated camera, or why there is none."""
    extraction = extractor.measure(image)
    centroids = extraction.centroids
    if len(centroids) < MIN_STARS:
        return Solution.none(identifier.camera, centroids, extraction.status, extraction.reason)
    solution = _solve_centroids(centroids, identifier, sky)
    if solution.sky is None:
        return solution
    found = solution.identification
    seen = bodies.in_image(solution.sky)
    spots = bodies.spots(solution.sky, centroids, found.magnitude)
    if (spots & (found.hip > 0)).any():
        solution = _solve_centroids(centroids.select(~spots), identifier, sky)
    return replace(solution, bodies=seen if solution.sky else ())


def _solve_centroids(centroids: Centroids, identifier: Identifier, sky: ApparentCatalog
                     ) -> Solution:
    found = icrf_identification(
        identifier.identify(centroids), centroids, identifier.camera, sky, identifier.options)
    camera = identifier.camera.with_focal_ratio(found.focal_ratio)
    mapping = None if found.attitude is None else SkyMapping(
        camera, found.attitude.quaternion, sky.observer.state)
    return Solution(centroids, found, camera, sky=mapping)


@dataclass(frozen=True)
class Outputs:
    """
    Folders of annotated pictures and of FITS headers, None for no such files.

    With deep_sky the pictures name Messier, NGC and IC objects.
    """

    annotate_folder: Path | None = None
    wcs_folder: Path | None = None
    deep_sky: bool = False

    def check(self) -> None:
        """
        Make the folders, before long work and not after it.

        OutputError where that fails, MissingLibraryError for deep_sky without its library.
        """
        if self.deep_sky:
            check_deep_sky()
        for folder in (self.annotate_folder, self.wcs_folder):
            if folder is not None:
                output_folder(folder)

    @property
    def writers(self) -> tuple[Callable[[str, Solution], Path | None], ...]:
        """
        Return what writes the file of each kind, and returns its path, None for no such file.

        Each is called with a name without a suffix and a solution. OutputError, and WcsError of
        Solution.wcs().
        """
        return self._write_picture, self._write_wcs

    def _write_picture(self, name: str, solution: Solution) -> Path | None:
        if self.annotate_folder is None:
            return None
        picture = solution.annotate(name, deep_sky=self.deep_sky)
        # In memory: OpenCV reports a full disk on stderr alone.
        content = cv2.imencode('.png', picture[..., ::-1])[1].tobytes()
        return _written(self.annotate_folder / f'{name}.png', content)

    def _write_wcs(self, name: str, solution: Solution) -> Path | None:
        if self.wcs_folder is None or not solution.solved:
            return None
        return _written(self.wcs_folder / f'{name}.wcs', wcs_header(solution.wcs()))


def _written(path: Path, content: bytes) -> Path:
    write_output(path, content)
    return path


def solve_files(paths: Sequence[Path], *, fov_deg: float | None = None,
                camera_file: Path | None = None, epoch_year: float | None = None,
                observer_site: ObserverSite = ObserverSite(), mirror: bool = False,
                selection: slice = slice(None), outputs: Outputs = Outputs(),
                catalogue: Path | None = None, near_deg: tuple[float, float] | None = None,
                dark_file: Path | None = None,
                options: IdentificationOptions = IdentificationOptions()) -> Result:
    """
    Solve image files of the camera of camera_file, or of an uncalibrated one of fov_deg.

    The lens of the latter is fitted to each image. Without both, EXIF has the field of view; all
    fields and fisheyes are searched where that is unknown or does not fit. catalogue is the folder
    of one for narrow fields, near_deg their right ascension and declination within NEAR_DEG;
    without it that of a FITS header, and anywhere. epoch_year None is the time of each image by
    EXIF, else today. mirror flips each image from left to right first; the result is that of the
    flipped image. A mirrored FITS image whose header has no ROWORDER has its first row at the top.
    selection is that of the frames of videos and of animated or paged files, each of which is a
    row. dark_file is a dark frame or a list of bad pixels (dark.py) of all images. CameraError for
    an impossible camera, CatalogueError for a folder without a catalogue, ImageError for a
    dark_file that cannot be read, OutputError for an impossible folder of outputs; an unreadable
    image is a row of its own, and so is one that fails otherwise. Those among the first images
    of a camera are tried again with what later ones show.
    """
    outputs.check()
    dark = None if dark_file is None else read_dark(dark_file)
    if fov_deg is not None:
        given_camera(1, 1, fov_deg)
    call = _Call(
        Solvers(fov_deg, None if camera_file is None else load_camera(camera_file), options,
                catalogue), observer_site, outputs, dark, mirror, epoch_year, near_deg)
    done = [call.solve(shot) for shot in progress(
        shots(paths, output_names(paths), selection), 'solve',
        None if any(map(is_video, paths)) else len(paths), name=lambda shot: shot.label)]
    for number, one in enumerate(done):
        if one.early and call.sequence.knows(one.early):
            for shot in shots([one.shot.path], [one.shot.output], selection):
                again = call.solve(shot, certain=True)
                done[number] = again if again.row['solved'] else one
    rows = [one.row for one in done]
    written = [Path(file) for row in rows for file in row['written']]
    like_another = sum(1 for row in rows if row['lens_from'])
    whens = [one.when for one in done if one.when] or [epoch_of(epoch_year)]
    observers = [one.observer for one in done if one.observer] or [
        observer_site.observer(whens[0])]
    fit = ({'camera_residual_px': read_wcs_camera(camera_file).residual_px}
           if camera_file is not None and is_wcs(camera_file) else {})
    notes = {name: _some([one.notes[name] for one in done if name in one.notes])
             for name in _NOTES}
    return Result('solve', rows, {
        **fit, **({'mirror': True} if mirror else {}),
        **({'lens of another image': f'{like_another} images'} if like_another else {}),
        **{name: text for name, text in notes.items() if text},
        **({'written': _files_text(written)} if written else {}),
        'epoch': whens[0].year,
        'epoch_from': _different(when.source for when in whens),
        'aberration': _different(observer.condition for observer in observers)}, DETAILS)


class _Done(NamedTuple):
    """
    A shot without its pixels, its row, time, observer, and what is said of it below the table.

    early is the camera of an image that is not solved and of which later ones may tell more.
    """

    shot: Shot
    row: dict[str, Any]
    when: Epoch | None = None
    observer: Observer | None = None
    notes: dict[str, str] = {}
    early: CameraKey | None = None


_NOTES = 'fov_deg', 'mirrored', 'first row at the top', 'uncatalogued'


@dataclass(frozen=True)
class _Call:
    """What solves the shots of one call; the arguments of solve_files()."""

    solvers: 'Solvers'
    observer_site: ObserverSite
    outputs: Outputs
    dark: Dark | None
    mirror: bool
    epoch_year: float | None
    near_deg: tuple[float, float] | None
    sequence: ImageSequence = field(default_factory=ImageSequence)

    def solve(self, shot: Shot, certain: bool = False) -> _Done:
        """Solve a shot and write its files; certain is whether to search a known lens alone."""
        row = _row(shot, None, np.full(2, np.nan)) | {'status': 'unreadable', 'reason': shot.error}
        done = _Done(shot._replace(photograph=None), row)
        if shot.photograph is None:
            return done
        solution: Solution | None = None
        with OneOfSeveral(partial(row.__setitem__, 'reason')):
            photograph = (shot.photograph if self.dark is None
                          else self.dark.subtracted(shot.photograph))
            photograph = photograph.mirror() if self.mirror else photograph
            when = epoch_of(self.epoch_year, photograph.taken)
            observer = self.observer_site.observer(when)
            early = (shot.frame is None and self.solvers.fits_lens
                     and self.sequence.learns(photograph))
            solution, solve_ms = self.solvers.solve(
                shot.path, photograph, when, observer, self.observer_site.bodies(when),
                self.near_deg, self.sequence, certain)
            self.sequence.add(shot.label, photograph, when, solution)
        if solution is None:
            return done
        row.update(_row(shot, solution, solve_ms), epoch=when.year, epoch_from=when.source)
        written = row['written'] = list[str]()
        for write in self.outputs.writers:
            with OneOfSeveral(partial(row.__setitem__, 'not_written')):
                if (file := write(shot.output, solution)) is not None:
                    written.append(str(file))
        return done._replace(
            when=when, observer=observer, notes=_notes(shot.label, solution),
            early=camera_key(photograph) if early and not solution.solved else None)


def _notes(label: str, solution: Solution) -> dict[str, str]:
    """Return what is said of an image below the table, of _NOTES."""
    notes = dict[str, str]()
    if solution.dropped is not None:
        notes['fov_deg'] = (f'{label}: {np.degrees(solution.dropped.fov_x_rad):.3g} deg given, '
                            f'{np.degrees(solution.camera.seen_x_rad):.3g} fits')
    if solution.mirrored:
        notes['mirrored'] = label
    if solution.turned_over:
        notes['first row at the top'] = label
    if spots := solution.uncatalogued:
        notes['uncatalogued'] = (f'{label}: {len(spots)} brighter than V '
                                 f'{max(one.magnitude for one in spots) + 0.05:.1f}')
    return notes


def _some(texts: Sequence[str]) -> str:
    """Return the first of some texts, and how many more there are."""
    more = len(texts) - _MOST_NAMED
    return '; '.join([*texts[:_MOST_NAMED], *([f'{more} more'] if more > 0 else [])])


def _files_text(files: Sequence[Path]) -> str:
    """Return the names of some files, of many how many are in each folder."""
    if len(files) <= _MOST_NAMED:
        return ', '.join(map(str, files))
    counts = Counter(file.parent for file in files)
    return ', '.join(f'{count} files in {folder}' for folder, count in counts.items())


def _different(texts: Iterable[str]) -> str:
    return '; '.join(dict.fromkeys(texts))


def given_camera(width: int, height: int, fov_deg: float) -> Camera | None:
    """
    Return the ideal camera of a field of view, None for one so wide that no such lens has it.

    CameraError for an impossible field.
    """
    wide = fov_deg > HIGHEST_DEG
    camera = ideal_camera(width, height, fov_deg, EQUIDISTANT if wide else PLUMB_BOB)
    return None if wide else camera


class Solvers:
    """
    What solves images, by camera and epoch.

    The camera is a calibrated one, or an uncalibrated one of fov_deg, or without both that of the
    file or any. catalogue is the folder of one for narrow fields of uncalibrated cameras.
    """

    def __init__(self, fov_deg: float | None, camera: Camera | None,
                 options: IdentificationOptions, catalogue: Path | str | None = None) -> None:
        """CatalogueError for a folder without a catalogue."""
        self._fov_deg = fov_deg
        self._calibrated = camera
        # Images of one camera and one night mostly follow each other. Not of methods of this
        # object: the cycle would keep the databases until garbage is collected.
        self._photographs = lru_cache(maxsize=2)(partial(
            PhotographSolver, options=options,
            catalogue=None if catalogue is None else TiledCatalogue(catalogue)))
        self._calibrations = lru_cache(maxsize=4)(partial(_calibrated_solver, options))

    @property
    def fits_lens(self) -> bool:
        """Whether the lens is fitted to each image, not that of a calibrated camera."""
        return self._calibrated is None

    def solve(self, path: Path | str, photograph: Photograph, when: Epoch, observer: Observer,
              bodies: Bodies, near_deg: tuple[float, float] | None = None,
              sequence: ImageSequence | None = None, certain: bool = False
              ) -> tuple[Solution, np.ndarray]:
        """
        Return the solution of an image, and time and processor time in ms (2,); ImageError.

        A mirrored image is turned over where the order of its rows is not known, else flipped from
        left to right; clusters of hot pixels are removed where an image has no solution with them.
        near_deg is that of solve_files(); sequence has the images of the camera before, whose lens
        is the only one with certain.
        """
        near_deg = near_deg or photograph.pointing_deg
        place = None if near_deg is None else Place.near(*near_deg, NEAR_DEG)
        given, known = photograph, None
        if sequence is not None and self.fits_lens:
            photograph, known = sequence.ordered(photograph), sequence.known(photograph, when)
            known = known._replace(certain=True) if known and certain else known
        solve = partial(self._solve, path, when=when, observer=observer, bodies=bodies,
                        place=place, known=known)
        solution, time_ms = solve(photograph)
        if solution.status == 'mirrored':
            other = photograph.mirror() if photograph.order_known else photograph.turn_over()
            flipped, more_ms = solve(other)
            time_ms = time_ms + more_ms
            if flipped.solved:
                solution, photograph = flipped, other
        elif not solution.solved and not (known and known.certain):
            # Sharp stars of compressed images look like such clusters: not the first choice.
            clean = without_clusters(photograph.image)
            if clean is not photograph.image:
                cleaned, more_ms = solve(photograph._replace(image=clean))
                solution = cleaned.of_tries(2) if cleaned.solved else solution
                time_ms = time_ms + more_ms
        return replace(
            solution, photograph=photograph, epoch_year=when.year,
            mirrored=photograph.mirrored != given.mirrored,
            turned_over=photograph.bottom_up != given.bottom_up), time_ms

    def _solve(self, path: Path | str, photograph: Photograph, when: Epoch, observer: Observer,
               bodies: Bodies, place: Place | None, known: Known | None
               ) -> tuple[Solution, np.ndarray]:
        image = photograph.image
        if self._calibrated is None:
            given_deg = self._fov_deg or photograph.fov_x_deg
            fov_deg = given_deg or (known and known.fov_deg)
            height, width = image.shape
            nominal = None if fov_deg is None else given_camera(width, height, fov_deg)
            # Identifiers round epochs to years.
            solver = self._photographs(round(when.year))
            start_s = _clocks_s()
            solution = solver.solve(image, nominal, observer, bodies, place, known)
            if nominal is not None and known is not None and given_deg is None:
                solution = replace(solution, dropped=None, lens_from=(
                    known.source if solution.solved and solution.dropped is None else ''))
        else:
            camera = camera_of(path, image, self._calibrated, None)
            # In 9 days no bright star moves by 0.1 arcsec.
            year = when.year if when.source == OPTION else round(20 * when.year) / 20
            identifier, onboard = self._calibrations(camera, year)
            sky = ApparentCatalog(onboard, observer)
            start_s = _clocks_s()
            # A new extractor, so that no image depends on those before.
            solution = solve_image(image, CentroidExtractor(), identifier, sky, bodies)
        return solution, 1e3 * (_clocks_s() - start_s)


def _clocks_s() -> np.ndarray:
    """Return the time, and the processor time of this process."""
    return np.array([time.perf_counter(), time.process_time()])


def _calibrated_solver(options: IdentificationOptions, camera: Camera, year: float
                       ) -> tuple[Identifier, OnboardCatalog]:
    return make_identifier(camera, year, options), camera_stars(camera, year)


def _row(shot: Shot, solution: Solution | None, solve_ms: np.ndarray) -> dict[str, object]:
    numbers = ('ra_deg', 'dec_deg', 'roll_deg', 'fov_deg', 'residual_arcsec')
    row: dict[str, object] = {
           'file': shot.label, 'solved': False, **dict.fromkeys(numbers, float('nan')),
           'matched': 0, 'solve_ms': float(solve_ms[0]), 'reason': '',
           **dict.fromkeys(DETAILS), 'cpu_ms': float(solve_ms[1]), 'written': [],
           'path': str(shot.path), 'frame': shot.frame, 'time_s': shot.time_s,
           'not_written': '', 'lens_from': ''}
    if solution is None:
        return row
    row.update(reason=solution.reason, status=solution.status, detected=len(solution.centroids),
               lens_from=solution.lens_from, mirrored=solution.mirrored,
               false_alarm_probability=solution.false_alarm)
    row['bodies'] = [{key: value for key, value in body._asdict().items() if key != 'radius_px'}
                     for body in solution.bodies]
    row['uncatalogued'] = [one._asdict() for one in solution.uncatalogued]
    attitude, camera = solution.identification.attitude, solution.camera
    if attitude is not None:
        row.update({name: getattr(solution, name) for name in numbers})
        row.update(solved=True, matched=solution.matched, quaternion=attitude.quaternion.tolist(),
                   covariance_sensor=attitude.covariance_sensor.ravel().tolist(),
                   lens={'fx': camera.fx, 'fy': camera.fy, 'cx': camera.cx, 'cy': camera.cy,
                         'distortion': list(camera.distortion),
                         'distortion_model': camera.distortion_model})
    return row
