# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Documents match the code: commands and examples run, named texts, parameters, links exist."""

import ast
import configparser
from contextlib import suppress
from functools import cache
from importlib import import_module
from importlib.util import find_spec
import json
import os
from pathlib import Path
import re
import runpy
import shlex
import shutil
import signal
import subprocess
import sys

from commands import invoke
from docutils.core import publish_doctree
from docutils.utils import Reporter
from limits import HANGS_S
import pytest
import startracker_ros
from startracker_ros.command_line import main
from startracker_ros.ros.executables import EXECUTABLES, NODES
from startracker_ros.ros.node import PipelineNode
from startracker_ros.ros.processes import take_domain
from startracker_ros.tools.cli.outcome import Commands

ROOT = Path(__file__).parents[2]
DOCUMENTS = {path.relative_to(ROOT).as_posix(): path.read_text()
             for path in (ROOT / 'README.md', *sorted((ROOT / 'docs').rglob('*.md')))}
# Listings of readme and start page are files of docs/examples, which tests compare and run.
RUN_AS_A_WHOLE = [name for name, text in DOCUMENTS.items()
                  if name not in ('README.md', 'docs/index.md') and '```python' in text]
# In a block or inline, behind a prompt or not, by the path of the venv or not.
COMMAND = re.compile(r'(?:^\$? ?|`)(?:\.venv/bin/)?startracker ((?:[a-z-]+|--help)\b[^`\n]*)',
                     re.MULTILINE)
COMMANDS = sorted({(name, found.strip()) for name, text in DOCUMENTS.items()
                   for found in COMMAND.findall(text)})
# Run to their end here. The others are not, because they need or take
#   demo, record, play                 half a minute or no end; test/nodes runs them
#   run                                no end; every node is run in test/nodes
#   info, report, export               bags that the reader has; test/tools/report makes some
#   solve and calibrate of files       that the reader has: run where they are those of the tests
#   doctor                             a network; test/tools/doctor runs it
#   campaign, bench                    minutes; test/evaluation runs them smaller
# ros2, colcon, pip, make, systemctl   tools that a ROS 2 install or the tests of the install have
# Pages of docs with Python run as a whole, with their commands in blocks of a console.
CHEAP = ('--help', '--version')


def sub_command(words: list[str]):
    """Return the command of click that words name, and how many words that takes."""
    command, depth = main, 0
    while depth < len(words) and isinstance(command, Commands):
        assert words[depth] in command.every(), words
        command, depth = command.every()[words[depth]], depth + 1
    return command, depth


def test_there_are_commands():
    assert len(COMMANDS) > 30


@pytest.mark.parametrize('document, text', COMMANDS)
def test_every_command_and_option_in_a_document_exists(document, text):
    # `startracker campaign quad` `hausdorff`: only the first is complete.
    words = shlex.split(text, comments=True)
    if words[0] in CHEAP:
        return
    command, depth = sub_command(words)
    shown = invoke(*words[:depth], '--help')
    if words[0] == 'run':
        assert len(words) == 1 or words[1] in EXECUTABLES, text
        return
    assert shown.exit_code == 0, (document, text)
    known = {name for parameter in command.params for name in (
        *parameter.opts, *parameter.secondary_opts)}
    named = [word.partition('=')[0] for word in words[depth:] if re.match('--?[a-z]', word)]
    assert set(named) <= known | {'--help', '-h'}, (document, text)


@pytest.mark.parametrize('option', CHEAP)
def test_cheap_commands_run(option):
    assert invoke(option).exit_code == 0


@pytest.mark.slow
@pytest.mark.parametrize('text', sorted(
    {text for _, text in COMMANDS if text.endswith('night-sky-11deg/*.png')}))
def test_commands_on_the_photographs_run(text, sky_data, tmp_path, monkeypatch):
    (tmp_path / 'test').mkdir()
    (tmp_path / 'test' / 'data').symlink_to(sky_data)
    monkeypatch.chdir(tmp_path)
    *words, pattern = shlex.split(text)
    files = sorted(path.as_posix() for path in Path().glob(pattern))
    done = invoke(*words, *files)
    assert files and done.exit_code == 0, done.output
    assert ('camera.yaml' in words) == (tmp_path / 'camera.yaml').exists()


@pytest.mark.slow
def test_photographs_of_the_readme_are_solved_as_printed(sky_data):
    printed = [[cell.strip() for cell in line.strip('│').split('│')]
               for line in DOCUMENTS['README.md'].splitlines() if line.startswith('│ 2019-')]
    files = [str(sky_data / 'night-sky-11deg' / cells[0]) for cells in printed]
    done = invoke('solve', '--fov-deg', '11.4', '--epoch', '2019.57', '--json', *files)
    for cells, row in zip(printed, json.loads(done.stdout)['rows'], strict=True):
        assert cells[1] == 'yes' and row['solved']
        # Of a busy machine another step of the search may be the first one in time.
        for cell, name in zip(cells[2:], ('ra_deg', 'dec_deg', 'roll_deg', 'fov_deg')):
            assert float(cell) == pytest.approx(row[name], abs=2e-3), (cells[0], name)


@pytest.mark.slow
def test_the_calibration_prints_what_its_page_says(sky_data, tmp_path, monkeypatch):
    command, _, printed = re.search(r'\$ startracker (calibrate .*)(\n)((?s:.*?))```',
                                    DOCUMENTS['docs/calibration.md']).groups()
    monkeypatch.chdir(tmp_path)
    *words, _ = shlex.split(command)
    done = invoke(*words, *map(str, sorted((sky_data / 'night-sky-11deg').glob('*.png'))))
    number = re.compile(r'(?<![\w-])-?\d+\.?\d*(?![\w-])')
    assert number.sub('', done.output).split() == number.sub('', printed).split()
    # Other processors round otherwise, and a star more or less is matched.
    assert [float(text) for text in number.findall(done.output)] == pytest.approx(
        [float(text) for text in number.findall(printed)], rel=0.02)


def test_modules_nodes_and_targets_named_in_documents_exist():
    everything = '\n'.join(DOCUMENTS.values())
    for module in set(re.findall(r'python -m (startracker_ros[a-z_.]*[a-z_])', everything)):
        assert find_spec(module), module
    for node in re.findall(r'^ros2 run startracker_ros ([a-z_]+)', everything, re.MULTILINE):
        assert node in EXECUTABLES
    for file in re.findall(r'^ros2 launch startracker_ros (\S+)', everything, re.MULTILINE):
        assert (ROOT / 'launch' / file).is_file()
    for node, name in re.findall(r'^ros2 param set /([a-z_]+) ([a-z_]+)', everything,
                                 re.MULTILINE):
        assert name in parameters()[node]
    targets = (ROOT / 'Makefile').read_text()
    for target in re.findall(r'^make ([a-z-]+)', everything, re.MULTILINE):
        assert f'\n{target}:' in targets


def test_the_gallery_has_every_picture_and_the_command_that_makes_it():
    gallery = DOCUMENTS['docs/gallery.md']
    links = {name: set(re.findall(r'\]\(((?:pictures/)?[a-z_0-9/-]+\.(?:png|jpg))\)', text))
             for name, text in DOCUMENTS.items()}
    elsewhere = links['docs/simulator.md'] | links['docs/papers.md']
    pictures = {path.relative_to(ROOT / 'docs').as_posix() for path in (ROOT / 'docs').rglob('*')
                if path.suffix in ('.png', '.jpg')}
    assert pictures - elsewhere <= links['docs/gallery.md'] <= pictures
    makes_pictures = re.compile(r'\b(picture|pictures|page|PNG)\b')

    def makers(command, names):
        for name, each in command.every().items() if isinstance(command, Commands) else ():
            yield from makers(each, (*names, name))
        if any(makes_pictures.search(getattr(parameter, 'help', None) or '')
               for parameter in command.params):
            yield ' '.join(names)
    found = [*makers(main, ('startracker',))]
    assert len(found) > 12
    assert [name for name in found if name not in gallery] == []


def test_python_listings_are_python():
    count = 0
    for name, text in DOCUMENTS.items():
        for listing in re.findall(r'```python\n(.*?)```', text, re.DOTALL):
            compile(listing, name, 'exec')
            count += 1
    assert count >= 3


def test_the_listing_in_cpp_is_the_example():
    text = (ROOT / 'docs' / 'examples' / 'attitude_listener.cpp').read_text()
    _, _, example = text.partition('\n\n')  # The copyright.
    assert f'```cpp\n{example}```' in DOCUMENTS['docs/integration.md']
    assert example.count('{') == example.count('}') and example.count('(') == example.count(')')


@pytest.mark.parametrize('document', ['README.md', 'docs/index.md'])
def test_the_example_of_the_library_prints_what_the_document_says(
        document, sky_data, monkeypatch, capsys):
    path = ROOT / 'docs' / 'examples' / 'solve_image.py'
    listing = path.read_text().split('"""', 2)[2].strip()
    image, *others = re.search(r'`python docs/examples/solve_image.py test/data/([^`]*)`',
                               DOCUMENTS['README.md'])[1].split()
    monkeypatch.setattr('sys.argv', [str(path), str(sky_data / image), *others])
    runpy.run_path(str(path))
    assert f'```python\n{listing}\n```' in DOCUMENTS[document]
    assert f'```\n{capsys.readouterr().out}```' in DOCUMENTS[document]


def test_examples_use_public_names():
    listings = [listing for text in DOCUMENTS.values()
                for kind, listing, _ in BLOCK.findall(text) if kind == 'python']
    examples = [path.read_text() for path in (ROOT / 'docs' / 'examples').glob('*.py')]
    assert len(listings) > 10 and len(examples) > 3
    for text in listings + examples:
        assert 'from startracker_ros' not in text and 'import startracker_ros.' not in text, text
        named = set(re.findall(r'\bst\.([A-Za-z_]\w*)', text))
        assert named <= set(startracker_ros.__all__), text


# With what it prints, where that is in a block right behind it.
BLOCK = re.compile(r'^```(\w*)\n(.*?)^```$(?:\n\n```\n(.*?)^```$)?', re.MULTILINE | re.DOTALL)
FILE = re.compile(r'# ([\w.]+\.(?:py|yaml))\n')
FRAMES = dict.fromkeys(map(ord, '┏━┳┓┃┡╇┩│└─┴┘'), ' ')
NEXT = '--- next command ---'


def is_same(printed: str, word: str) -> bool:
    """Return whether a word is the printed one; other processors round decimals otherwise."""
    if not all(re.fullmatch(r'[-+]?\d+\.\d+', each) for each in (printed, word)):
        return printed == word
    last_digit = 10.0 ** -len(printed.partition('.')[2])
    return abs(float(printed) - float(word)) < max(2.5 * last_digit, 2e-3)


def are_same(printed: list[str], words: list[str]) -> bool:
    return len(printed) == len(words) and all(map(is_same, printed, words))


def check_output(printed: str, output: str) -> None:
    """Check the words of an output, whatever stands for `...` and draws the tables."""
    first, *others = [part.split() for part in printed.translate(FRAMES).split('...')]
    words, place = output.translate(FRAMES).split(), len(first)
    assert are_same(first, words[:place]), output
    for part in others:
        place = next((end for end in range(place + len(part), len(words) + 1)
                      if are_same(part, words[end - len(part):end])
                      and (part is not others[-1] or end == len(words) or not part)), None)
        assert place is not None, (part, output)
    assert place == len(words) or (others and not others[-1]), output


def run_commands(commands: list[str]) -> list[str]:
    """Return the output of each command, in one shell; what it leaves behind is ended."""
    script = '\n'.join(['set -e', *(f"echo '{NEXT}'; {command}" for command in commands)])
    with subprocess.Popen(
            ['bash', '-c', script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            start_new_session=True, env=os.environ | {
                'ROS_DOMAIN_ID': take_domain(),
                'PATH': f"{Path(sys.executable).parent}:{os.environ['PATH']}"}) as shell:
        try:
            output, errors = shell.communicate(timeout=HANGS_S)
        finally:
            with suppress(ProcessLookupError):
                os.killpg(shell.pid, signal.SIGKILL)
    assert shell.returncode == 0, errors
    return output.split(f'{NEXT}\n')[1:]


@pytest.mark.slow
@pytest.mark.parametrize('name', RUN_AS_A_WHOLE)
def test_pages_run_as_printed(name, sky_data, tmp_path, monkeypatch, capsys):
    (tmp_path / 'test').mkdir()
    (tmp_path / 'test' / 'data').symlink_to(sky_data)
    monkeypatch.chdir(tmp_path)
    commands, listings = [], []
    for kind, text, printed in BLOCK.findall(DOCUMENTS[name]):
        if file := FILE.match(text):
            Path(file[1]).write_text(text)
        elif kind == 'console':
            commands += [each.partition('\n')[::2] for each in text.split('$ ')[1:]]
        elif kind == 'python':
            listings.append((text, printed))
    assert commands or listings
    for (_, printed), output in zip(
            commands, run_commands([command for command, _ in commands]), strict=True):
        if printed:
            check_output(printed, output)
    variables: dict[str, object] = {}
    for listing, printed in listings:
        exec(compile(listing, name, 'exec'), variables)
        if printed:
            check_output(printed, capsys.readouterr().out)


PEERS = ('smroid/cedar-solve', 'ssmichael1/tetra3rs', 'UWCubeSat/lost',
         'UBNanosatLab/openstartracker', 'dstndstn/astrometry.net')


def test_each_cell_of_the_features_says_where_to_see_it():
    page = DOCUMENTS['docs/features.md']
    commits = dict(re.findall(r'github\.com/([\w.-]+/[\w.-]+)/tree/([0-9a-f]{40})\) \| ', page))
    assert tuple(commits) == PEERS
    rows = [line.strip('| ').split(' | ') for line in page.splitlines() if line.count(' | ') > 5]
    rows = [row for row in rows if 'startracker_ros' not in row[0]]
    assert len(rows) > 20
    for name, ours, *peers in rows:
        # That the links lead somewhere is tested for all pages.
        assert re.fullmatch(r'(?!no: `)\S.*: \[[^]]+\]\([\w./-]+(?:#[\w-]+)?\)', ours), ours
        assert len(peers) == len(PEERS), name
        for peer, cell in zip(PEERS, peers):
            source = fr'{re.escape(f"https://github.com/{peer}/blob/{commits[peer]}")}/\S+#L\d+'
            if peer.endswith('tetra3rs'):
                source += r'|https://pypi\.org/project/tetra3rs/0\.14\.0/#files'
            assert re.fullmatch(fr'no: `[^`]+`|\S.*: \[[^]]+\]\((?:{source})\)', cell), cell


def test_tables_of_the_readme_fit_a_terminal():
    lines = [line for line in DOCUMENTS['README.md'].splitlines() if line.startswith(('|', '│'))]
    assert len(lines) > 40
    assert [line for line in lines if len(line) > 100] == []


def anchors(text: str) -> set[str]:
    """Return the anchors that GitHub makes of headings."""
    return {re.sub(r'[^\w\- ]', '', heading.lower()).strip().replace(' ', '-')
            for heading in re.findall(r'^#+ (.*)$', text, re.MULTILINE)}


@pytest.mark.parametrize('document', DOCUMENTS)
def test_a_table_stands_by_itself(document):
    # Behind a line of text it is a part of that line.
    lines = ['', *DOCUMENTS[document].splitlines()]
    for before, line in zip(lines, lines[1:]):
        assert not line.startswith('|') or not before or before.startswith('|'), line


@pytest.mark.parametrize('document', DOCUMENTS)
def test_links_lead_somewhere(document):
    for link in re.findall(r'\]\(([^)\s]+)\)', DOCUMENTS[document]):
        if '://' in link:
            continue
        path, _, anchor = link.partition('#')
        target = (ROOT / document).parent / path if path else ROOT / document
        assert target.exists(), link
        if anchor:
            assert anchor in anchors(target.read_text()), link


@cache
def texts_of_the_source() -> str:
    """Return every text in the source, a line each, with … where values are put in."""
    texts = []
    for path in ROOT.glob('startracker_ros/**/*.py'):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.JoinedStr):
                texts.append(''.join(part.value if isinstance(part, ast.Constant) else '…'
                                     for part in node.values))
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(re.sub(r'{\w[^{}]*}', '…', node.value))
    return '\n'.join(texts)


def test_texts_of_the_troubleshooting_are_those_of_the_nodes():
    sections = DOCUMENTS['docs/troubleshooting.md'].split('## Without any text')
    texts = re.findall(r'^\| `([^`]+)` \|', sections[0], re.MULTILINE)
    assert len(texts) > 30
    for text in texts:
        assert len(re.sub('[^a-z]', '', text)) >= 8, text
        assert text in texts_of_the_source(), text


@cache
def parameters() -> dict[str, set[str]]:
    """Return the names of the parameters of every node."""
    found = {}
    for node, module in NODES.items():
        classes = [value for value in vars(import_module(module)).values()
                   if isinstance(value, type) and issubclass(value, PipelineNode)
                   and value.__module__ == module]
        found[node] = {row.name for cls in classes for options in cls.option_classes
                       for row in options.table()}
    return found


def test_parameters_named_in_the_tuning_exist():
    known = set().union(*parameters().values())
    table = DOCUMENTS['docs/tuning.md'].split('## By symptom')[1].split('## What not')[0]
    named = 0
    for line in table.splitlines():
        cells = line.split(' | ')
        if len(cells) != 4 or cells[0].startswith(('| symptom', '|---')):
            continue
        for word in re.findall('`([a-z_0-9]+)(?:: [^`]*)?`', cells[1]):
            assert word in known or word in EXECUTABLES, line
            named += 1
        pairs = re.findall('`([a-z_0-9]+)(?:: [^`]*)?` of `([a-z_]+)`', cells[1])
        assert all(name in parameters()[node] for name, node in pairs), line
    assert named > 20


def test_changelog_is_in_the_form_of_catkin():
    text = (ROOT / 'CHANGELOG.rst').read_text()
    tree = publish_doctree(text, settings_overrides={
        'halt_level': Reporter.WARNING_LEVEL, 'report_level': Reporter.WARNING_LEVEL})
    assert tree.next_node(lambda node: node.tagname == 'title').astext() == (
        'Changelog for package startracker_ros')
    assert re.search(r'^(Forthcoming|\d+\.\d+\.\d+ \(\d{4}-\d\d-\d\d\))\n-+\n', text, re.MULTILINE)


def test_systemd_unit(tmp_path):
    source = ROOT / 'docs' / 'examples' / 'startracker.service'
    unit = configparser.RawConfigParser(strict=False)
    unit.optionxform = str
    unit.read(source)
    words = shlex.split(unit['Service']['ExecStart'])
    assert words[1:4] == ['run', '%i', '--ros-args']
    enabled = re.findall(r'startracker@([a-z_]+)', source.read_text())
    assert enabled and set(enabled) <= set(NODES)
    verifier = shutil.which('systemd-analyze')
    if verifier:
        named = tmp_path / 'startracker@star_tracker.service'
        named.write_text(source.read_text().replace(words[0], shutil.which('true')))
        done = subprocess.run([verifier, 'verify', '--man=no', str(named)],
                              capture_output=True, text=True, timeout=HANGS_S)
        assert named.name not in done.stderr, done.stderr
