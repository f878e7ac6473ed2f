# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Words that a reader would have to decode are in neither code nor documents."""

from pathlib import Path
import re

import pytest

ROOT = Path(__file__).parents[2]
FOLDERS = ('startracker_ros', 'native', 'evaluation/startracker_evaluation', 'test', 'docs',
           'config', 'launch', 'bags')
FILES = [ROOT / 'README.md', ROOT / 'evaluation' / 'README.md', *(
    path for folder in FOLDERS for path in sorted((ROOT / folder).rglob('*'))
    if path.suffix in ('.py', '.c', '.cpp', '.h', '.md', '.yaml', '.js', '.html', '.j2')
    and path != Path(__file__))]
# Names of fields, of keys and of others stay; they stand in quotes or in a longer name.
INSTEAD = {
    r'[Ss]poil\w*': 'contaminated, damaged',
    r'(?<!\w)rest(?:s|ing)(?!\w)': 'idle',
    r"(?<![\w'`])directed(?![\w'`])": 'windowed',
    r'common[ _]error': 'correlated error',
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
    # Jinja has `is none`.
    r'(?<!there )(?<!There )(?<!camera )(?<!rate )\b(?:is|are|was|were) none\b':
        'is not, is invalid',
    r'(?<!there )(?<!There )\b(?:is|are|was|were) no (?!\w+er\b|more\b|less\b|such\b)':
        'is not a',
    r'\banew\b': 'again, restarts, resets',
    r'\bstamps? (?:that |may |have )?err(?:s|ed)?\b': 'timestamp errors',
    r'\b(?:leaves?|left) (?:no )?room\b': 'allows',
    r'\b(?:takes?|taken|taking|took) out\b': 'remove, subtract',
    r'[Vv]antage': 'observer state',
    r'TrackBank|track_bank': 'track list',
    r'\blacking\b': 'covariance deficit, missing',
    r'\w_room\b|\broom_': 'capacity, variance bound',
    r'(?i)light[ _]shift': 'centroid shift',
    r'way of (?:the )?least variance': 'by the model with the smallest variance',
    # The key of the rows of startracker doctor.
    r"(?<![`.'\"])\b[Mm]end(?:s|ed|ing)?\b(?!: str|')": 'fix',
    # A function of the C header.
    r"(?<!fusion_)(?<!call\(')[Ll]earnt": 'estimated',
    r'rows? that tells?\b|speaks against': 'evidence',
    r'Recorded flights': 'recordings',
    r"\bof (?:one's|your) own\b": 'custom, separate',
    r'\bmay be off\b': 'is uncertain',
    # Not the variables of that name.
    r'(?<=[a-z,;:.)] )[Bb]eside (?!in |is L)(?=[A-Za-z])':
        'next to, in addition to, compared with',
    r'that a parameter has is': 'setting a parameter to its current value',
    r'are typed and are added': 'names may be added, never changed',
}

# Between the lines of a comment or of a string.
BREAK = re.compile(r"""[ '"]*\n[ #/*>-]*(?:f?['"]+)?""")
TEXTS = {path.relative_to(ROOT).as_posix(): BREAK.sub(' ', path.read_text()) for path in FILES}


GENERATED = ('docs/commands.md', 'docs/parameters.md', 'docs/papers.md')
# Listings, marks of results and where these are from; rows of tables are left out by their bar.
NOT_PROSE = re.compile(r'^```.*?^```|<!--.*?-->|^\[[\w.-]+\.json\]\(.*?$', re.M | re.DOTALL)


def test_pages_are_short():
    pages = [path for path in (ROOT / 'README.md', *sorted((ROOT / 'docs').rglob('*.md')))
             if path.relative_to(ROOT).as_posix() not in GENERATED]
    words = [word for path in pages for line in NOT_PROSE.sub('', path.read_text()).splitlines()
             if not line.startswith('|') for word in line.split()]
    assert 10_000 < len(words) < 20_000


@pytest.mark.parametrize('word', INSTEAD)
def test_other_words_are_used(word):
    found = [f'{path}: ... {text[max(0, match.start() - 50):match.end() + 30]} ...'
             for path, text in TEXTS.items() for match in re.finditer(word, text)]
    assert not found, '\n'.join([f'say {INSTEAD[word]}:', *found])
