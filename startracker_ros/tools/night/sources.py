# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The images of a night with their stamps: out of a bag, a folder or a video."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from startracker_ros.core.astro.epoch import stamp_from_epoch_year
from startracker_ros.core.camera.model import Camera, CameraError
from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.bags.folder import is_bag
from startracker_ros.io.bags.layouts import (
    camera_from_message, image_from_message, MessageError, ns_from_stamp)
from startracker_ros.io.bags.reader import matches, read_messages, read_topics, why_nothing
from startracker_ros.io.images.exif import Taken
from startracker_ros.io.images.images import image_paths, ImageError, read_photograph
from startracker_ros.io.images.video import frames, is_video
from startracker_ros.io.recordings.recording import full_name
from startracker_ros.io.several_files import OneOfSeveral

_IMAGE, _CAMERA_INFO = 'image_raw', 'camera_info'
_IMAGE_TYPE = 'sensor_msgs/msg/Image'


class TimedImage(NamedTuple):
    """An image (H, W) uint8 or uint16, and UNIX time in ns of its exposure."""

    stamp_ns: int
    image: np.ndarray


class NightError(ValueError):
    """Images that are not a night; the text says what is missing."""


def timed_images(source: Path, start_year: float | None, interval_s: float | None,
                 namespace: str | None, *, zone_needed: bool = False,
                 left_out: list[str] | None = None) -> Iterator[TimedImage]:
    """
    Yield the images of a bag, a folder or a video, in order of their stamps.

    Those of a folder are stamped by their files, EXIF or DATE-OBS. Where start_year is given the
    first one is of that time, and where interval_s is given each is so much later than the one
    before. left_out gets the reason for each file of a folder that cannot be read. NightError
    where no stamps are known, or where needed no zone of them, or no file can be read;
    ImageError, BagError.
    """
    if is_bag(source):
        yield from _of_bag(source, namespace)
    elif is_video(source):
        begin_ns = 0
        for frame in frames(source):
            if not frame.number:
                begin_ns = _begin_ns(source, start_year, frame.taken)
            elif interval_s is None and not frame.time_s:
                raise NightError(f'{source}: no times in it, --interval-s is needed')
            time_s = frame.time_s if interval_s is None else frame.number * interval_s
            yield TimedImage(begin_ns + round(time_s * 1e9), frame.image)
    else:
        yield from _of_files(source, start_year, interval_s, zone_needed,
                             [] if left_out is None else left_out)


def _begin_ns(source: Path, start_year: float | None, taken: Taken | None) -> int:
    """Return the stamp of the first image, the given one or that of its file."""
    if start_year is not None:
        return stamp_from_epoch_year(start_year)
    if taken is None:
        raise NightError(f'{source}: no time in it, --epoch of the first image is needed')
    return taken.stamp_ns


def _of_files(folder: Path, start_year: float | None, interval_s: float | None,
              zone_needed: bool, left_out: list[str]) -> Iterator[TimedImage]:
    begin_ns, first, started = 0, None, False
    for number, path in enumerate(image_paths([folder])):
        photograph = None
        with OneOfSeveral(left_out.append):
            photograph = read_photograph(path)
        if photograph is None:
            continue
        taken = photograph.taken
        if not started:
            begin_ns, first, started = _begin_ns(path, start_year, taken), taken, True
            if start_year is None and interval_s is not None:
                # It may not be the first file.
                begin_ns -= round(number * interval_s * 1e9)
            if zone_needed and start_year is None and taken and not taken.zone_known:
                raise NightError(f'{path}: no time zone in it, --epoch is needed for --site')
        if interval_s is not None:
            later_ns = round(number * interval_s * 1e9)
        elif taken is None or first is None:
            raise NightError(f'{path}: no time in it, --interval-s is needed')
        else:
            later_ns = taken.stamp_ns - first.stamp_ns
        yield TimedImage(begin_ns + later_ns, photograph.image)
    if left_out and not started:
        raise NightError(left_out[0])


def _of_bag(bag: Path, namespace: str | None) -> Iterator[TimedImage]:
    topic = full_name(_namespace(bag, namespace), _IMAGE)
    for message in read_messages(bag, topics=(topic,), tolerant=True):
        decoded = message.decoded()
        try:
            yield TimedImage(ns_from_stamp(decoded.header.stamp),
                             image_from_message(decoded).pixels)
        except MessageError as error:
            raise ImageError(f'{bag}: {topic}: {error}') from error


def camera_of_bag(bag: Path, namespace: str | None) -> Camera:
    """Return the camera of the images by the first camera_info; BagError without one."""
    name = _namespace(bag, namespace)
    topic = full_name(name, _CAMERA_INFO)
    try:
        for message in read_messages(bag, topics=(topic,), tolerant=True):
            camera = camera_from_message(message.decoded())
            topic = full_name(name, _IMAGE)
            for image in read_messages(bag, topics=(topic,), tolerant=True):
                return camera.summed(image_from_message(image.decoded()).cell)
            return camera
    except (CameraError, MessageError) as error:
        raise BagError(f'{bag}: {topic}: {error}') from error
    raise BagError(f'{bag}: no {topic}: --camera is needed')


def _namespace(bag: Path, namespace: str | None) -> str:
    topics = read_topics(bag, tolerant=True)
    wanted = f'*/{_IMAGE}' if namespace is None else full_name(namespace.strip('/'), _IMAGE)
    found = sorted(name.removesuffix(f'/{_IMAGE}').strip('/') for name, topic in topics.items()
                   if matches(name, (wanted,)) and topic.type_name == _IMAGE_TYPE
                   and topic.message_count)
    if not found:
        raise BagError(f'{bag}: no images: {why_nothing(topics, {wanted: _IMAGE_TYPE})}')
    if len(found) > 1:
        raise BagError(f'{bag}: image_raw of the namespaces {", ".join(map(repr, found))}: '
                       'choose one with --namespace')
    return found[0]
