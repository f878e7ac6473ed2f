# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
Identification methods and motion models by name; each is registered in one place.

The core registers its own here. Those of papers register themselves in core/papers/__init__.py,
of which only the last line of this file knows. A registration of a method names the class without
importing it, so that tables of options have the names at no cost. Models are those of the native
core: no other one can be registered.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Any


@dataclass(frozen=True)
class Registration:
    """Where a class is, as module:Name."""

    where: str

    def load(self) -> Any:
        """Return the class."""
        module, _, name = self.where.partition(':')
        return getattr(import_module(module), name)


@dataclass(frozen=True)
class Method(Registration):
    """An identification method, a class of Identifier; in_a_plane if its patterns are planar."""

    in_a_plane: bool = False


@dataclass(frozen=True)
class Model:
    """
    A model of the motion of stars, of the native core.

    options are those of TrackerOptions that have an effect only in models that name them; ignored
    are those that have none in this model.
    """

    options: tuple[str, ...] = ()
    ignored: tuple[str, ...] = ()


METHODS = {'pyramid': Method('startracker_ros.core.identify.pyramid:PyramidIdentifier')}
"""The methods of `method`, in the order of its choices."""

MODELS = {'attitude': Model()}
"""The motion models of `model`, in the order of its choices, which is that of st_motion_model."""

import_module('startracker_ros.core.papers')
