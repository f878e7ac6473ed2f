# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The built site, as `make docs` leaves it: every link leads somewhere, every page fits."""

from collections.abc import Iterator
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
import re
from urllib.parse import unquote

from browser import Page
import pytest

# What stands out of its column. What scrolls in its own box must have that box in the column.
OFFENDERS = """(() => {
  const column = document.querySelector('article').getBoundingClientRect();
  const out = (box) => box.right > column.right + 1 || box.left < column.left - 1;
  const scrolls = (element) => element.closest('pre, div.math');
  const found = [...document.querySelectorAll('article *')].filter((element) =>
    element.checkVisibility() && out(element.getBoundingClientRect())
    && (!scrolls(element) || scrolls(element) === element));
  if (document.documentElement.scrollWidth > innerWidth) found.push(document.body);
  return found.map((element) => element.outerHTML.slice(0, 120));
})()"""
# Text of less than 4.5 times the luminance of what it is on (WCAG 2, AA).
FAINT = """(() => {
  const numbers = (colour) => colour.match(/[\\d.]+/g).map(Number);
  const luminance = (colour) => numbers(colour).slice(0, 3).map((value) => value / 255)
    .map((value) => value <= 0.03928 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4)
    .reduce((sum, value, k) => sum + value * [0.2126, 0.7152, 0.0722][k], 0.05);
  const behind = (element) => {
    const colour = getComputedStyle(element).backgroundColor;
    return (numbers(colour)[3] ?? 1) > 0.5 || !element.parentElement ? colour
      : behind(element.parentElement);
  };
  return [...document.querySelectorAll('article :is(h1, h2, p, li, td, th, a, code)')]
    .filter((element) => element.checkVisibility() && element.textContent.trim()
      && !element.matches('.headerlink')).filter((element) => {
      const both = [getComputedStyle(element).color, behind(element)].map(luminance);
      return Math.max(...both) / Math.min(...both) < 4.5;
    }).map((element) => element.outerHTML.slice(0, 120));
})()"""


class Links(HTMLParser):
    """The addresses that a page has, and those it refers to."""

    def __init__(self) -> None:
        super().__init__()
        self.names: set[str] = set()
        self.targets: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Take what an element is and what it refers to."""
        for name, value in attrs:
            if name in ('id', 'name') and value:
                self.names.add(value)
            elif name in ('href', 'src') and value is not None and tag != 'base':
                self.targets.add(value)


@cache
def links(path: Path) -> Links:
    """Return those of a page."""
    found = Links()
    found.feed(path.read_text())
    return found


@pytest.fixture
def pages(site: Path) -> list[Path]:
    """Return every page."""
    return sorted(site.rglob('*.html'))


def dead_links(page: Path) -> Iterator[str]:
    """Yield the links of a page that lead nowhere in the site."""
    for target in links(page).targets:
        path, _, anchor = unquote(target).partition('#')
        file = page.parent / path.partition('?')[0] if path else page
        if re.match('[a-z]+:', target):
            continue
        if not file.is_file() or (anchor and file.suffix == '.html'
                                  and anchor not in links(file).names):
            yield f'{page.name}: {target}'


def test_every_link_leads_somewhere(pages):
    assert len(pages) > 40
    assert [dead for page in pages for dead in dead_links(page)] == []


def test_every_page_is_in_the_contents(site, pages):
    listed = {(site / path.partition('#')[0]).resolve()
              for path in links(site / 'search.html').targets}
    assert [page.name for page in pages if page not in listed and page.stem != 'search'] == []


def test_every_page_fits_a_phone_and_a_screen_light_and_dark(page: Page, pages):
    found = []
    for path in pages:
        page.load(path)
        found += [(path.name, problem) for problem in page.problems]
        for width, phone in ((390, True), (1400, False)):
            page.resize(width, 844, phone=phone)
            # Chromium may say so later.
            page.evaluate("dispatchEvent(new Event('resize'))")
            found += [(path.name, width, each) for each in page.evaluate(OFFENDERS)]
        for dark in (False, True):
            page.resize(1400, 844, dark=dark)
            found += [(path.name, dark, each) for each in page.evaluate(FAINT)]
    assert found == []


def test_search_finds_a_page(page: Page, site):
    page.load(f'{(site / "search.html").as_uri()}?q=quaternion')
    assert page.evaluate("""new Promise((done) => {
      const look = () => document.querySelector('#search-results li a')
        ? done(true) : setTimeout(look, 50);
      look();
      setTimeout(() => done(false), 20000);
    })""")
