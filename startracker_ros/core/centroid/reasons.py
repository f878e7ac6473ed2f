# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The sentence for each reason of the library why an image has no stars."""

from collections.abc import Callable, Mapping
from typing import Any

from startracker_ros.core.centroid.image_tracker import KINDS

_WORDS = {
    'edge': 'cut by the edge', 'saturated': 'saturated', 'hot_pixel': 'hot pixels',
    'cosmic_ray': 'hits of particles', 'elongated': 'longer than a star',
    'too_wide': 'wider than a star', 'not_fitted': 'of no shape of a star',
    'faint': 'too faint', 'disc': 'of something large', 'line': 'of a line'}
_REMEDIES = {
    'saturated': 'expose shorter', 'hot_pixel': 'subtract a dark frame',
    'cosmic_ray': 'subtract a dark frame', 'elongated': 'expose shorter, or let nothing shake',
    'too_wide': 'focus, and keep Moon and lamps out of the field',
    'disc': 'keep Moon, lamps and clouds out of the field',
    'line': 'expose shorter, or let nothing shake'}
_REMEDY = 'expose longer and focus'
# Status and sentence by st_reason_code, of the figures of the reason.
_REASONS: dict[int, tuple[str, Callable[..., str]]] = {
    100: ('too_small', lambda width, height, least: (
        f'image of {width:.0f} x {height:.0f} px, at least {least:.0f} px a side are needed')),
    101: ('blank', lambda level, *_: f'all pixels are {level:.0f} DN'),
    102: ('saturated', lambda full, *_: f'most pixels are at full scale, {full:g} DN'),
    103: ('too_many', lambda peaks, *_: (
        f'{peaks:.0f} peaks: noise, not stars: raise the threshold, or subtract a dark frame')),
    104: ('no_stars', lambda sigmas, dn, *_: (
        f'no star image above {_threshold(sigmas, dn)}: expose longer, focus, or lower the '
        'threshold')),
    106: ('torn', lambda first, last, *_: (
        f'the rows {first:.0f} to {last:.0f} are those of the frame before: a torn frame')),
    107: ('repeated', lambda *_: 'the image is that of the frame before, with its noise'),
    108: ('repeated', lambda moved_px, *_: (
        f'the image is that of the frame before, though the stars have moved {moved_px:.1f} px')),
    109: ('readout', lambda readout_s, interval_s, *_: (
        f'read-out of {readout_s:.3g} s, but {interval_s:.3g} s since the frame before: is '
        'line_time_us right?')),
    110: ('streak', lambda length_px, *_: (
        f'streaks of {length_px:.1f} px in another direction than the stars move'))}
_ALL_REJECTED = 105


def rejections(figures: Mapping[str, Any]) -> dict[str, int]:
    """Return how many detections an EXTRACTION has left out for each of the KINDS."""
    return {kind: int(count) for kind, count in zip(KINDS, figures['rejected_by_kind']) if count}


def status_and_reason(figures: Mapping[str, Any]) -> tuple[str, str]:
    """Return the status of an EXTRACTION by its names, and the sentence for its reason."""
    code, _, numbers = figures['reason']
    if not code:
        return 'ok', ''
    if code == _ALL_REJECTED:
        return 'no_stars', _rejected_text(rejections(figures))
    status, text = _REASONS[code]
    return status, text(*numbers[:3])


def _threshold(sigmas: float, dn: float) -> str:
    return f'{dn:.1f} DN' if dn > 0 else f'{sigmas:g} sigma'


def _rejected_text(rejected: Mapping[str, int]) -> str:
    """Return what the detections are, the most frequent first, and what helps against those."""
    counts = sorted(rejected.items(), key=lambda item: -item[1])
    kinds = ', '.join(f'{count} {_WORDS.get(kind, kind)}' for kind, count in counts)
    return (f'none of {sum(rejected.values())} detections is a star ({kinds}): '
            f'{_REMEDIES.get(counts[0][0], _REMEDY)}')
