# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The photographs of files: one of an image, one for each frame of a video."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, count, islice
from pathlib import Path
from typing import NamedTuple

from startracker_ros.io.images.images import ImageError, Photograph, read_photograph
from startracker_ros.io.images.video import frames, is_video


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
        try:
            if not is_video(path):
                yield Shot(path, name, read_photograph(path))
                continue
            number = None
            for number, time_s, image in islice(
                    frames(path), selection.start, selection.stop, selection.step):
                yield Shot(path, f'{name}_frame{number:05d}', Photograph(image), frame=number,
                           time_s=time_s)
            if number is None:
                yield Shot(path, name, error=f'{path}: --frames selects no frame of it')
        except ImageError as error:
            yield Shot(path, name, error=str(error))


def output_names(paths: Sequence[Path]) -> list[str]:
    """Return a name of the files for each image, numbered where several have the same."""
    names: dict[str, None] = {}
    for path in paths:
        numbered = (f'{path.stem}-{number}' for number in count(2))
        names[next(name for name in chain([path.stem], numbered) if name not in names)] = None
    return [*names]
