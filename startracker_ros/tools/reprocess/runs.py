# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs on disk: their trackers and tables."""

from dataclasses import dataclass
import json
from pathlib import Path

import numpy as np
from startracker_ros.core.astro.epoch import utc
from startracker_ros.io.bags.errors import BagError
from startracker_ros.tools.reprocess.run import SUMMARY
from startracker_ros.tools.reprocess.tables import file_spans_ns, read_table


@dataclass(frozen=True)
class Run:
    """The folder of one run of reprocess, and its star trackers."""

    folder: Path
    trackers: tuple[str, ...]

    @property
    def days(self) -> list[str]:
        """The days with frames, as 2026-01-01."""
        return sorted(path.name.removeprefix('day=')
                      for path in (self.folder / 'tables' / 'frames').glob('day=*'))

    def same_times(self, tracker: str) -> str:
        """Return which bags of a tracker hold frames of the same times, empty where none do."""
        newest: dict[str, int] = {}
        for begin_ns, end_ns, bag in file_spans_ns(self.folder / 'tables', 'frames', tracker):
            for other, other_end_ns in newest.items():
                if other != bag and begin_ns <= other_end_ns:
                    return (f'{tracker}: the bags {other} and {bag} both hold frames of '
                            f'{utc(begin_ns)} to {utc(min(end_ns, other_end_ns))}: for figures '
                            'of one, reprocess it into a folder of its own')
            newest[bag] = max(end_ns, newest.get(bag, 0))
        return ''

    def table(self, name: str, tracker: str, columns: list[str], day: str = '*'
              ) -> dict[str, np.ndarray]:
        """Return columns of a table in the order of the stamps; unknown values are NaN."""
        return read_table(self.folder / 'tables', name, tracker, columns, day)

    def vectors(self, table: dict[str, np.ndarray], pattern: str, names: str = 'xyz'
                ) -> np.ndarray:
        """Return columns (N, K) by a pattern of their names."""
        return np.stack([table[pattern.format(name)].astype(float) for name in names], -1)


def open_run(folder: Path) -> Run:
    """Return the run in a folder; BagError if there is none."""
    path = folder / SUMMARY
    try:
        content = json.loads(path.read_text())
        return Run(folder, tuple(content['trackers']))
    except (OSError, ValueError, KeyError, TypeError) as error:
        sets = sorted(found.parent.name for found in folder.glob(f'*/{SUMMARY}'))
        hint = f'; it holds the runs {", ".join(sets)}' if sets else ''
        raise BagError(f'{folder} is no finished run of `startracker reprocess`{hint}') from error
