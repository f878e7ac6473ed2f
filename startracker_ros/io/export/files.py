# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The export command: a bag in, files of other formats out."""

from collections.abc import Sequence
from pathlib import Path
import time

from startracker_ros.io.bags.errors import BagError
from startracker_ros.io.export.aem import aem_text, AemLabels
from startracker_ros.io.export.tables import (
    load_parquet_writer, TABLE_TOPICS, TABLES, write_csv, write_parquet)
from startracker_ros.io.output import output_folder, write_output
from startracker_ros.io.recordings.loading import load_recording
from startracker_ros.io.recordings.recording import lock_segments
from startracker_ros.io.table import Result


def export_bag(bag: Path, folder: Path, formats: Sequence[str], labels: AemLabels,
               namespace: str | None = None) -> Result:
    """
    Write the files and return a row for each: file, rows.

    BagError when the bag cannot be read, AemError when it has no attitude for an AEM,
    MissingLibraryError before anything is written, OSError when a file cannot be.
    """
    if not bag.exists():
        raise BagError(f'{bag} does not exist')
    if 'parquet' in formats:
        load_parquet_writer()
    recording = load_recording(bag, namespace)
    texts = {}
    if 'aem' in formats:
        texts['attitude.aem'] = aem_text(recording, labels, time.time_ns())
    output_folder(folder)
    rows, empty = [], list[str]()
    for name, text in texts.items():
        write_output(folder / name, text)
        rows.append({'file': str(folder / name), 'rows': len(recording.attitude_ns)})
    for name, table_of in TABLES.items():
        table = table_of(recording)
        for kind, write in (('csv', write_csv), ('parquet', write_parquet)):
            if kind in formats:
                path = folder / f'{name}.{kind}'
                write(table, path)
                rows.append({'file': str(path), 'rows': len(table['stamp_ns'])})
        if not len(table['stamp_ns']):
            empty.append(f'{name}: {recording.why_nothing(*TABLE_TOPICS[name])}')
    segments = lock_segments(recording)
    problems = {'problem' if index == 0 else f'problem {index + 1}': problem
                for index, problem in enumerate(recording.problems)}
    return Result('export', rows, {
        'segments': int(segments[-1]) + 1 if len(segments) else 0,
        **({'without rows': '; '.join(empty)} if empty else {}), **problems})
