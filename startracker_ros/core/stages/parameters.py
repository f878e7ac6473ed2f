# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The options of the stages by the names of the node parameters."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from startracker_ros.core.astro.observer_motion import AberrationOptions
from startracker_ros.core.attitude.gyro import GyroErrorOptions
from startracker_ros.core.catalog.band import BandOptions
from startracker_ros.core.centroid.extraction import ExtractionOptions
from startracker_ros.core.identify.identification import IdentificationOptions
from startracker_ros.core.integrity.protection import ProtectionOptions
from startracker_ros.core.integrity.validation import UNUSED_SOLVER, ValidationOptions
from startracker_ros.core.options import Options, unknown_option
from startracker_ros.core.stages.extraction import SearchOptions
from startracker_ros.core.stages.identification import CheckOptions
from startracker_ros.core.track.options import TrackerOptions


@dataclass(frozen=True)
class StarTrackerOptions:
    """The options of all stages, those of the nodes by default."""

    extraction: ExtractionOptions = ExtractionOptions()
    search: SearchOptions = SearchOptions()
    identification: IdentificationOptions = IdentificationOptions()
    check: CheckOptions = CheckOptions()
    tracker: TrackerOptions = TrackerOptions()
    gyro: GyroErrorOptions = GyroErrorOptions()
    validation: ValidationOptions = ValidationOptions()
    protection: ProtectionOptions = ProtectionOptions()
    aberration: AberrationOptions = AberrationOptions()
    band: BandOptions = BandOptions()


NODES = {
    'centroid_extractor': ('extraction', 'search'),
    'star_identifier': ('identification', 'check', 'gyro', 'band'),
    'star_tracker': ('tracker', 'gyro', 'aberration', 'band'),
    'attitude_estimator': ('validation', 'protection', 'aberration')}
"""The stages of the pipeline that each node has the options of."""


class ParameterError(ValueError):
    """A parameter that is unknown or out of range; the text names it."""


_DEFAULTS = StarTrackerOptions()


def _known() -> dict[str, tuple[str, Any]]:
    """Return the stage and the default of each NODE.NAME."""
    kinds: dict[str, type[Options]] = {
        field.name: type(getattr(_DEFAULTS, field.name)) for field in fields(StarTrackerOptions)}
    return {f'{node}.{row.name}': (stage, row.default) for node, stages in NODES.items()
            for stage in stages for row in kinds[stage].table()}


KNOWN = _known()
"""Stage and default of each NODE.NAME."""


def options_of_nodes(values: Mapping[str, Any]) -> StarTrackerOptions:
    """
    Return the options with values by NODE.NAME, which must be known.

    ParameterError where a value is wrong, or two nodes differ in an option of one stage.
    """
    changed: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        stage, short = KNOWN[name][0], name.partition('.')[2]
        before = changed.setdefault(stage, {}).setdefault(short, value)
        if before != value:
            raise ParameterError(f'{short} is {before} of one node and {value} of another')
    try:
        return replace(_DEFAULTS, **{
            stage: replace(getattr(_DEFAULTS, stage), **of_stage)
            for stage, of_stage in changed.items()})
    except ValueError as error:
        raise ParameterError(str(error)) from error


def options_of_keywords(keywords: Mapping[str, Any]) -> StarTrackerOptions:
    """
    Return the options with values by NAME, which is of all nodes that have it.

    Where their defaults differ, it is another thing in each node: the value then needs the node,
    as in star_identifier={'method': 'quad'}, which is possible for all names. ParameterError.
    """
    values: dict[str, Any] = {}
    for keyword, value in keywords.items():
        if keyword not in NODES:
            values |= dict.fromkeys(_everywhere(keyword), value)
    for node in NODES.keys() & keywords.keys():
        if not isinstance(keywords[node], Mapping):
            raise ParameterError(f'{node} = {keywords[node]!r} must be a dict of its parameters')
        for name, value in keywords[node].items():
            if f'{node}.{name}' not in KNOWN:
                raise ParameterError(f'{node}: {unknown_option(name, _names(node))}')
            values[f'{node}.{name}'] = value
    options = options_of_nodes(values)
    if options.validation.solver not in (ValidationOptions.solver, options.tracker.solver):
        raise ParameterError(UNUSED_SOLVER.format(options.validation.solver))
    return options


def _everywhere(name: str) -> list[str]:
    """Return NODE.NAME of each node that has a name, if it is one thing in all of them."""
    nodes = [node for node in NODES if f'{node}.{name}' in KNOWN]
    if not nodes:
        known = set().union(*map(_names, NODES))
        raise ParameterError(unknown_option(name, known))
    if len({KNOWN[f'{node}.{name}'][1] for node in nodes}) > 1:
        choices = ' or '.join(f'{node}={{{name!r}: ...}}' for node in nodes)
        raise ParameterError(f'{name} is another option in each of {", ".join(nodes)}: write '
                             f'{choices}')
    return [f'{node}.{name}' for node in nodes]


def _names(node: str) -> set[str]:
    return {name.partition('.')[2] for name in KNOWN if name.startswith(f'{node}.')}
