# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The layout of a table: which columns fit a width, which texts stand below their rows."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import zip_longest
from textwrap import wrap

from rich.box import Box
from rich.cells import cell_len, set_cell_size

FILE_WIDTH = 160
"""Width of a table in a pipe or a file, in characters."""

# A column with a longer text is a remark, which may stand below its row.
_REMARK = 24
# The first column names the row; where space is short it is folded between words to this width.
_FOLDED = 32
_NOTHING = ('', '-')
# Of so many columns one at least is in a table.
_LEAST_SHOWN = 3
# Whether a row holds is never left out.
_ALWAYS = ('holds',)


def _fold(text: str, width: int) -> list[str]:
    """Return the lines of a text; a word that is longer than the width is not broken."""
    return wrap(text, width, break_long_words=False, break_on_hyphens=False) or ['']


@dataclass(frozen=True)
class Column:
    """
    A column: its header and one text for each row, both folded to lines of fold characters.

    It is at least so wide.
    """

    name: str
    texts: Sequence[str]
    numeric: bool = False
    fold: int = 10 ** 6
    least: int = 0
    split_header: bool = False

    @cached_property
    def header(self) -> list[str]:
        """Return the lines of the header, broken behind underscores if that saves space."""
        if not self.split_header or cell_len(self.name) <= max(map(cell_len, self.texts)):
            return [self.name]
        return self.name.replace('_', '_\n').split('\n')

    def cell(self, row: int) -> list[str]:
        """Return the lines of a cell."""
        return _fold(self.texts[row], self.fold)

    @cached_property
    def width(self) -> int:
        """Return the number of characters of the longest line, with one on either side."""
        cells = [self.header, *(self.cell(row) for row in range(len(self.texts)))]
        return max(self.least, 2 + max(cell_len(line) for cell in cells for line in cell))

    @property
    def is_remark(self) -> bool:
        """Whether the texts are remarks."""
        return not self.numeric and max(map(cell_len, self.texts), default=0) > _REMARK


@dataclass(frozen=True)
class Layout:
    """The columns of a table, those below the rows, and the names of those left out."""

    columns: Sequence[Column]
    below: Sequence[Column] = ()
    left_out: Sequence[str] = ()

    @property
    def width(self) -> int:
        """Return the number of characters of a line."""
        return sum(column.width for column in self.columns) + len(self.columns) + 1

    def widened(self, width: int) -> 'Layout':
        """Return the layout with a last column that leaves remarks the given width."""
        remarks = [f'{column.name}: {text}' for column in self.below for text in column.texts]
        more = min(width, 6 + max(map(cell_len, remarks), default=0)) - self.width
        if not remarks or more <= 0:
            return self
        *others, last = self.columns
        return replace(self, columns=[*others, replace(last, least=last.width + more)])

    def lines(self, box: Box) -> Iterator[str]:
        """Yield the lines of the table, drawn with the characters of a box."""
        widths = [column.width for column in self.columns]
        if not widths:
            return
        yield box.get_top(widths)
        yield from self._row([column.header for column in self.columns],
                             box.head_left, box.head_vertical, box.head_right)
        yield box.get_row(widths, 'head')
        for row in range(len(self.columns[0].texts)):
            yield from self._row([column.cell(row) for column in self.columns],
                                 box.mid_left, box.mid_vertical, box.mid_right)
            for line in self._remarks(row):
                padding = ' ' * (self.width - 6 - cell_len(line))
                yield f'{box.mid_left}   {line}{padding} {box.mid_right}'
        yield box.get_bottom(widths)

    def _remarks(self, row: int) -> Iterator[str]:
        for column in self.below:
            if column.texts[row] not in _NOTHING:
                yield from _fold(f'{column.name}: {column.texts[row]}', self.width - 6)

    def _row(self, cells: Sequence[list[str]], left: str, between: str, right: str
             ) -> Iterator[str]:
        for lines in zip_longest(*cells, fillvalue=''):
            yield left + between.join(
                f' {self._aligned(column, line)} '
                for column, line in zip(self.columns, lines)) + right

    @staticmethod
    def _aligned(column: Column, line: str) -> str:
        width = column.width - 2
        return (' ' * (width - cell_len(line)) + line if column.numeric
                else set_cell_size(line, width))


@dataclass(frozen=True)
class Paragraphs:
    """The rows below each other, of at most width characters: nothing is left out."""

    columns: Sequence[Column]
    width: int
    left_out: Sequence[str] = ()

    def lines(self, box: Box) -> Iterator[str]:
        """Yield the lines of the rows; a paragraph needs no box."""
        first, *others = self.columns
        for row, text in enumerate(first.texts):
            yield from _fold(text, self.width)
            line = ''
            for column in others:
                if column.texts[row] in _NOTHING:
                    continue
                item = f'  {column.name} {column.texts[row]}'
                if line and cell_len(line + item) > self.width:
                    yield line
                    line = ''
                if cell_len(item) > self.width:
                    yield from (f'  {part}' for part in _fold(
                        f'{column.name}: {column.texts[row]}', self.width - 2))
                else:
                    line += item
            if line:
                yield line


def fit(columns: Sequence[Column], width: int, *, drop: bool) -> Layout | Paragraphs:
    """
    Return a layout of at most width characters, as far as that is possible.

    Where the columns are wider, remarks go below the rows, headers are broken behind
    underscores, the first column is folded between words, and, if drop is set, columns are
    left out from the right; where most would be, the rows are paragraphs. No word is broken.
    """
    layout = Layout(columns)
    if layout.width > width:
        below = [column for column in columns[1:] if column.is_remark]
        layout = Layout([column for column in columns if column not in below], below)
    if layout.width > width:
        layout = replace(layout, columns=[
            replace(column, split_header=True) for column in layout.columns])
    if layout.width > width:
        first, *others = layout.columns
        layout = replace(layout, columns=[replace(first, fold=_FOLDED), *others])
    while drop and layout.width > width:
        optional = [column for column in layout.columns[1:] if column.name not in _ALWAYS]
        if not optional:
            break
        layout = Layout([column for column in layout.columns if column is not optional[-1]],
                        layout.below, [optional[-1].name, *layout.left_out])
    if len(layout.columns) * _LEAST_SHOWN < len(columns) - len(layout.below):
        return Paragraphs(columns, width)
    return layout.widened(width)
