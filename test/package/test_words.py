# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Words that a reader would have to decode are in neither code nor documents."""

from pathlib import Path
import re

import pytest

ROOT = Path(__file__).parents[2]
FILES = [path for folder in (
    'startracker_ros', 'evaluation/startracker_evaluation', 'test', 'docs', 'config', 'bags')
         for path in sorted((ROOT / folder).rglob('*'))
         if path.suffix in ('.py', '.md', '.yaml', '.js', '.html')
         and path != Path(__file__)] + [ROOT / 'README.md']
# Names of fields, of keys and of others stay; they stand in quotes or in a longer name.
INSTEAD = {
    r'[Ss]poil\w*': 'contaminated, damaged',
    r'(?<!\w)rest(?:s|ing)(?!\w)': 'idle',
    r"(?<![\w'`])directed(?![\w'`])": 'windowed',
    r'(?<!\w)common[ _]error': 'correlated error',
    r'[Oo]ccasion\b': 'epoch',
    r'[Ss]tandpoint': 'observer site',
    r'look_from': 'the observer as an argument',
    r"(?<![\w'])(?<!┃ )told(?!')": 'given',
    r'(?<!\w)begun(?!\w)': 'started',
    r'(?<!\w)rungs?(?!\w)': 'step of the ladder',
    r'(?:the only|six|each|every|upper|lower) rooms?(?!\w)': 'package',
    # A dark frame is the exposure without light that solve subtracts.
    r'is_dark': 'sparse frame',
    r'carr(?:y|ies) on': 'is used alone, continues',
}


@pytest.mark.parametrize('word', INSTEAD)
def test_other_words_are_used(word):
    found = [f'{path.relative_to(ROOT)}:{number}: {line.strip()}'
             for path in FILES for number, line in enumerate(path.read_text().splitlines(), 1)
             if re.search(word, line)]
    assert not found, '\n'.join([f'say {INSTEAD[word]}:', *found])
