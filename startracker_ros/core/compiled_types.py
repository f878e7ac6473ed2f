# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The types of arguments of compiled functions as JSON, and back."""

from importlib import import_module
from typing import Any

from numba import types


def encode(kind: Any) -> Any:
    """Return a type of numba as JSON."""
    if isinstance(kind, types.Array):
        writable = '' if kind.mutable else 'readonly '
        return f'{writable}{kind.dtype}[{kind.ndim}{kind.layout}]'
    if isinstance(kind, types.BaseNamedTuple):
        fields: Any = kind
        return {'named': _name(fields.instance_class), 'of': [encode(one) for one in fields.types]}
    if isinstance(kind, types.BaseTuple):
        return [encode(one) for one in kind]  # type: ignore[attr-defined]
    if isinstance(kind, types.StructRef):
        return {'struct': _name(type(kind)),
                'of': [[name, encode(one)] for name, one in kind._fields]}
    if isinstance(kind, types.Omitted):
        return {'omitted': kind.value}
    if isinstance(kind, types.Optional):
        return {'optional': encode(kind.type)}
    if str(kind) in ('none', 'bool', 'unicode_type') or isinstance(kind, types.Number):
        return str(kind)
    raise TypeError(f'a compiled function is called with {kind}: compiled_types.py lacks it')


def decode(text: Any) -> types.Type:
    """Return the type of numba; what encode() takes."""
    if isinstance(text, list):
        return types.BaseTuple.from_types([decode(one) for one in text])
    if isinstance(text, dict):
        return _decode_object(text)
    dtype, bracket, shape = text.rpartition('[')
    if not bracket:
        return _scalar(text)
    readonly = dtype.startswith('readonly ')
    return types.Array(_scalar(dtype.removeprefix('readonly ')), int(shape[0]), shape[1],
                       readonly=readonly)


def _scalar(name: str) -> types.Type:
    return types.boolean if name == 'bool' else getattr(types, name)


def _decode_object(text: dict) -> types.Type:
    if 'named' in text:
        return types.BaseTuple.from_types([decode(one) for one in text['of']],
                                          _class(text['named']))
    if 'struct' in text:
        return _class(text['struct'])([(name, decode(one)) for name, one in text['of']])
    if 'omitted' in text:
        return types.Omitted(text['omitted'])
    return types.Optional(decode(text['optional']))


def _name(cls: type) -> str:
    return f'{cls.__module__}:{cls.__qualname__}'


def _class(name: str) -> Any:
    module, _, attribute = name.partition(':')
    return getattr(import_module(module), attribute)
