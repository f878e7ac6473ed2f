# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Options of the algorithms: frozen dataclasses whose fields carry unit, range and meaning.

Node parameters, the annotated YAML in config/ and the README tables are all made
from these fields, so a default or a range stands in one place only.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields
import difflib
import math
from numbers import Integral, Real
from typing import Any


@dataclass(frozen=True)
class Option:
    """
    One row of a parameter table; low and high are inclusive, None means unbounded.

    live: a change does not reset the algorithm.
    """

    name: str
    default: Any
    unit: str
    low: float | None
    high: float | None
    choices: tuple[str, ...]
    read_only: bool
    live: bool
    description: str

    @property
    def range_text(self) -> str:
        """Return the permitted values in words, empty when anything of the type goes."""
        if self.choices:
            return 'one of ' + ', '.join(self.choices)
        if self.low is None and self.high is None:
            return ''
        low = '-inf' if self.low is None else f'{self.low:g}'
        high = 'inf' if self.high is None else f'{self.high:g}'
        return f'{low} .. {high}'

    def check(self, value: Any) -> Any:
        """Return value in the type of the default; ValueError names option, value and range."""
        wanted = type(self.default)
        # NumPy scalars and whole numbers are welcome, booleans are not numbers.
        if wanted in (float, int) and not isinstance(value, bool):
            kind = Real if wanted is float else Integral
            value = wanted(value) if isinstance(value, kind) else value
        if type(value) is not wanted and not (
                wanted is tuple and isinstance(value, (tuple, list))):
            raise ValueError(
                f'{self.name} = {value!r} is of type {type(value).__name__}, '
                f'must be {wanted.__name__}')
        if wanted is tuple:
            value = tuple(value)
            numeric = not isinstance(self.default[0], str)
            if numeric and len(value) != len(self.default):
                raise ValueError(
                    f'{self.name} = {value!r} must have {len(self.default)} elements')
            if any(type(element) is not type(self.default[0]) for element in value):
                raise ValueError(
                    f'{self.name} = {value!r} must hold {type(self.default[0]).__name__} only')
        elements = value if wanted is tuple else (value,)
        for element in elements:
            if isinstance(element, float) and not math.isfinite(element):
                raise ValueError(f'{self.name} = {value!r} is not finite')
            if isinstance(element, (int, float)) and not isinstance(element, bool) and (
                    (self.low is not None and element < self.low)
                    or (self.high is not None and element > self.high)):
                unit = f' {self.unit}' if self.unit else ''
                raise ValueError(
                    f'{self.name} = {value!r} is out of range {self.range_text}{unit}')
            if self.choices and element not in self.choices:
                raise ValueError(
                    f'{self.name} = {value!r} must be {self.range_text}')
        return value


def option(default: Any, description: str, *, unit: str = '', low: float | None = None,
           high: float | None = None, choices: tuple[str, ...] = (),
           read_only: bool = False, live: bool = False) -> Any:
    """Return a dataclass field for a subclass of Options."""
    return field(default=default, metadata={'option': (
        unit, low, high, choices, read_only, live, description)})


@dataclass(frozen=True)
class Options:
    """Base of every options class: checks each field when it is made."""

    def __post_init__(self) -> None:
        for row in self.table():
            object.__setattr__(self, row.name, row.check(getattr(self, row.name)))

    @property
    def changed(self) -> list[str]:
        """Return the names of the options that are not the default."""
        return [row.name for row in self.table() if getattr(self, row.name) != row.default]

    @classmethod
    def table(cls) -> tuple[Option, ...]:
        """Return the rows of this class, in the order of definition."""
        return tuple(Option(f.name, f.default, *f.metadata['option']) for f in fields(cls))


def unknown_option(name: str, known: Collection[str]) -> str:
    """Return what is wrong with a name, the nearest one that is known, and all of them."""
    near = difflib.get_close_matches(name, known, 1)
    hint = f', did you mean {near[0]}?' if near else ','
    return f'unknown option {name}{hint} there are {", ".join(sorted(known))}'


def options_by_class(classes: Sequence[type[Options]], values: Mapping[str, Any]
                     ) -> dict[type[Options], Options]:
    """
    Return an instance of each class with the values of a mapping by name.

    ValueError for a name that no class has, with those that there are, and for a wrong value.
    """
    rows = {cls: {row.name for row in cls.table()} for cls in classes}
    known = set().union(*rows.values())
    for name in values:
        if name not in known:
            raise ValueError(unknown_option(name, known))
    return {cls: cls(**{name: value for name, value in values.items() if name in names})
            for cls, names in rows.items()}


def yaml_value(value: object) -> str:
    """Return a parameter value on one line of YAML, as the ROS parameter parser reads it."""
    import yaml  # few programs write parameters
    value = list(value) if isinstance(value, tuple) else value
    text = yaml.safe_dump(value, default_flow_style=True, width=10 ** 6)
    return text.removesuffix('\n').removesuffix('\n...')
