# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Node parameters from options classes: declaration, and rejection of bad values."""

from collections.abc import Sequence
import difflib
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter
from startracker_ros.core.options import Option, Options
from startracker_ros.ros.given_parameters import addressed_parameters
from startracker_ros.ros.messages.rclpy_internals import declared_parameters, parameter_overrides


class ParameterError(ValueError):
    """A parameter that is unknown or out of range; the text names it and the range."""


# Parameters that rclpy itself declares or reads.
_RCLPY_PARAMETERS = ('use_sim_time', 'start_type_description_service')


def _to_ros(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value


def _from_ros(value: Any) -> object:
    return tuple(value) if not isinstance(value, str) and hasattr(value, '__len__') else value


def _descriptor(row: Option) -> ParameterDescriptor:
    unit = f' [{row.unit}]' if row.unit else ''
    descriptor = ParameterDescriptor(
        name=row.name, description=f'{row.description}{unit}', read_only=row.read_only,
        additional_constraints=row.range_text)
    # The range in the descriptor is for tools; errors are worded by Option.check.
    if row.low is not None and row.high is not None:
        if isinstance(row.default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(row.low), to_value=float(row.high))]
        elif isinstance(row.default, int):
            descriptor.integer_range = [
                IntegerRange(from_value=int(row.low), to_value=int(row.high), step=1)]
    return descriptor


def declare(node: Node, classes: Sequence[type[Options]]) -> dict[type[Options], Options]:
    """
    Declare every option of the classes and return one instance of each.

    ParameterError names the parameter and its range when an override does not fit.
    """
    overrides = parameter_overrides(node)
    for row in (row for cls in classes for row in cls.table()):
        override = overrides.get(row.name)
        if override is not None:
            _check_override(row, override.value)
        declare_one(node, _to_ros(row.default), _descriptor(row))
    try:
        return {cls: read(node, cls) for cls in classes}
    except ValueError as error:
        raise ParameterError(str(error)) from error


def declare_one(node: Node, default: Any, descriptor: ParameterDescriptor) -> Any:
    """Declare a parameter and return its value; ParameterError if an override does not fit."""
    try:
        return node.declare_parameter(descriptor.name, default, descriptor).value
    except ParameterException as error:
        raise ParameterError(str(error)) from error


def _check_override(row: Option, value: object) -> None:
    if isinstance(row.default, float) and type(value) is int:
        raise ParameterError(f'{row.name} = {value} must be a double: write {value}.0')
    try:
        row.check(_from_ros(value))
    except ValueError as error:
        raise ParameterError(str(error)) from error


def check(classes: Sequence[type[Options]], changes: dict[str, object]) -> None:
    """Raise ParameterError for changes at run time that the options do not allow."""
    for row in (row for cls in classes for row in cls.table() if row.name in changes):
        if row.read_only:
            raise ParameterError(f'{row.name} is read at the start only: end the node and start '
                                 f'it again with -p {row.name}:=...')
        _check_override(row, changes[row.name])


def unknown(name: str, nodes: Sequence[Node]) -> str:
    """Return what is wrong with a name that no node declares, and the closest declared one."""
    near = _closest(name, nodes)
    return f'unknown parameter {name}' + (
        f'; did you mean {near}?' if near else f'; known: {", ".join(_declared(nodes))}')


def _closest(name: str, nodes: Sequence[Node]) -> str:
    """Return the declared name that is most like another, empty where none is."""
    return next(iter(difflib.get_close_matches(name, _declared(nodes), 1)), '')


def _declared(nodes: Sequence[Node]) -> list[str]:
    return [name for node in nodes for name in declared_parameters(node) if '.' not in name]


def is_current(node: Node, parameter: Parameter) -> bool:
    """Return whether a declared parameter has the type and the value of another."""
    if not node.has_parameter(parameter.name):
        return False
    current = node.get_parameter(parameter.name)
    return (current.type_ == parameter.type_
            and _from_ros(current.value) == _from_ros(parameter.value))


def read(node: Node, cls: type[Options], changes: dict[str, object] | None = None) -> Options:
    """Return the current options, or those after changes; ValueError if they are invalid."""
    names = [row.name for row in cls.table()]
    values = {name: node.get_parameter(name).value for name in names}
    values.update({name: value for name, value in (changes or {}).items() if name in values})
    return cls(**{name: _from_ros(value) for name, value in values.items()})


def reject_unknown(nodes: Sequence[Node], arguments: Sequence[str]) -> None:
    """
    Raise ParameterError for a parameter of a node that no node of this process declares.

    A misspelt safety limit that is silently ignored is worse than a node that does not start.
    What is set for all nodes, in a file under /** or by SetParameter of a launch file, may be
    meant for others, and is a warning.
    """
    known = {name for node in nodes for name in parameter_overrides(node)
             if node.has_parameter(name)}
    for node in nodes:
        foreign = [name for name in parameter_overrides(node)
                   if not (name in known or name in _RCLPY_PARAMETERS
                           or name.startswith('qos_overrides.'))]
        for name in set(foreign) & addressed_parameters(arguments, node.get_name()):
            raise ParameterError(unknown(name, nodes))
        if foreign:
            near = [f'; did you mean {found} for {name}?' for name in foreign
                    if (found := _closest(name, nodes))]
            node.get_logger().warning(
                f'not known here and ignored, as set for all nodes: {", ".join(foreign)}'
                + ''.join(near))
