# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Headless Chromium over its DevTools pipe: enough to load a page, point, click and look."""

import base64
from collections.abc import Iterator
from contextlib import contextmanager
import fcntl
import json
import os
from pathlib import Path
import re
import select
import shutil
import subprocess
import tempfile
import time
from typing import Any

_NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable')
# Without the flags on networking, Chromium calls its maker at each start.
_FLAGS = ('--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run',
          '--disable-background-networking', '--disable-component-update', '--disable-sync',
          '--disable-dev-shm-usage', '--hide-scrollbars', '--remote-debugging-pipe',
          'about:blank')
TIMEOUT_S = 300


class BrowserError(RuntimeError):
    """Chromium did not do what it was asked for."""


class Page:
    """One tab; problems collects console errors, exceptions and requests for anything else."""

    def __init__(self, commands: int, answers: int) -> None:
        self._commands, self._answers = commands, answers
        self._buffer = b''
        self._number = 0
        self._session: str | None = None
        self._events: list[str] = []
        self.problems: list[str] = []
        self._address = 'file:'
        target = self.call('Target.createTarget', url='about:blank')['targetId']
        self._session = self.call('Target.attachToTarget', targetId=target,
                                  flatten=True)['sessionId']
        for domain in ('Page', 'Runtime', 'Log', 'Network'):
            self.call(f'{domain}.enable')

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command of the DevTools protocol and return its result."""
        self._number += 1
        command = {'id': self._number, 'method': method, 'params': parameters}
        if self._session:
            command['sessionId'] = self._session
        data = json.dumps(command).encode() + b'\0'
        while data:
            data = data[os.write(self._commands, data):]
        while True:
            message = self._next()
            if message.get('id') == self._number:
                if 'error' in message:
                    raise BrowserError(f'{method}: {message["error"]}')
                return message['result']

    def load(self, page: Path | str) -> None:
        """Load a file or an address and wait until it has loaded and drawn."""
        # The page before may go on asking and failing until it is left.
        self._navigate('about:blank')
        self.problems.clear()
        self._address = 'file:' if isinstance(page, Path) else page
        self._navigate(page.as_uri() if isinstance(page, Path) else page)
        self.evaluate('new Promise((done) => requestAnimationFrame(() => '
                      'requestAnimationFrame(done)))')

    def _navigate(self, url: str) -> None:
        self._events.clear()
        self.call('Page.navigate', url=url)
        while 'Page.loadEventFired' not in self._events:
            self._next()

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression, awaited."""
        result = self.call('Runtime.evaluate', expression=expression, awaitPromise=True,
                           returnByValue=True)
        if 'exceptionDetails' in result:
            raise BrowserError(f'{expression}: {result["exceptionDetails"]}')
        return result['result'].get('value')

    def resize(self, width: int, height: int, *, phone: bool = False, dark: bool = False) -> None:
        """Set the size of the window in CSS pixels, its kind and the wanted colours."""
        self.call('Emulation.setDeviceMetricsOverride', width=width, height=height,
                  deviceScaleFactor=2 if phone else 1, mobile=phone)
        self.call('Emulation.setTouchEmulationEnabled', enabled=phone)
        self.call('Emulation.setEmulatedMedia', features=[
            {'name': 'prefers-color-scheme', 'value': 'dark' if dark else 'light'}])

    def mouse(self, kind: str, selector: str, x: float = 0.5, y: float = 0.5) -> None:
        """
        Let the mouse mouseMoved, mousePressed or mouseReleased at a place of an element.

        x and y go from 0 to 1 over the element, which is brought into view first.
        """
        place = self.evaluate(f"""(() => {{
            const element = document.querySelector({json.dumps(selector)});
            element.scrollIntoView({{block: 'center', behavior: 'instant'}});
            const box = element.getBoundingClientRect();
            return [box.left + {x} * box.width, box.top + {y} * box.height];
        }})()""")
        down = kind == 'mousePressed'
        self.call('Input.dispatchMouseEvent', type=kind, x=place[0], y=place[1],
                  button='none' if kind == 'mouseMoved' else 'left', buttons=int(down),
                  clickCount=0 if kind == 'mouseMoved' else 1)

    def click(self, selector: str) -> None:
        """Move to the middle of an element, press and release."""
        for kind in ('mouseMoved', 'mousePressed', 'mouseReleased'):
            self.mouse(kind, selector)

    def text(self, selector: str) -> str:
        """Return the text of the first element."""
        return self.evaluate(f'document.querySelector({json.dumps(selector)}).textContent')

    def count(self, selector: str) -> int:
        """Return how many elements there are."""
        return self.evaluate(f'document.querySelectorAll({json.dumps(selector)}).length')

    def screenshot(self, path: Path) -> None:
        """Write a PNG of what is in the window."""
        path.write_bytes(base64.b64decode(self.call(
            'Page.captureScreenshot', format='png')['data']))

    def _next(self) -> dict[str, Any]:
        end_s = time.monotonic() + TIMEOUT_S
        while b'\0' not in self._buffer:
            ready, _, _ = select.select([self._answers], [], [], end_s - time.monotonic())
            data = os.read(self._answers, 1 << 20) if ready else b''
            if not data:
                raise BrowserError('Chromium does not answer')
            self._buffer += data
        raw, _, self._buffer = self._buffer.partition(b'\0')
        message = json.loads(raw)
        self._note(message)
        return message

    def _note(self, message: dict[str, Any]) -> None:
        method, parameters = message.get('method', ''), message.get('params', {})
        self._events.append(method)
        if method == 'Runtime.exceptionThrown':
            self.problems.append(f'exception: {parameters["exceptionDetails"]}')
        elif method == 'Runtime.consoleAPICalled' and parameters['type'] in ('error', 'warning'):
            self.problems.append(f'console: {parameters["args"]}')
        elif method == 'Log.entryAdded' and parameters['entry']['level'] in ('error', 'warning'):
            self.problems.append(f'log: {parameters["entry"]["text"]}')
        elif method == 'Network.requestWillBeSent':
            url = parameters['request']['url']
            if not url.startswith((self._address, 'data:', 'about:')):
                self.problems.append(f'request: {url}')


def assert_readable(page: Page, path: Path | str, loaded: str = '') -> None:
    """
    Assert that a page is whole on phone and screen, light and dark, without a message.

    Its content is there once the JavaScript expression loaded is.
    """
    for width, phone in ((390, True), (1400, False)):
        for dark in (False, True):
            page.resize(width, 844, phone=phone, dark=dark)
            page.load(path)
            page.evaluate(loaded)
            assert not page.problems, page.problems
            assert page.evaluate('document.documentElement.scrollWidth') <= width
            assert page.evaluate("""Math.min(...[...document.querySelectorAll('p, td, th, dd')]
                .map((element) => parseFloat(getComputedStyle(element).fontSize)))""") >= 11
            background = page.evaluate('getComputedStyle(document.body).backgroundColor')
            assert (sum(map(int, re.findall(r'\d+', background)[:3])) < 150) == dark
            # What is wider than the screen can be scrolled, and pictures are never wider.
            assert page.evaluate("""[...document.querySelectorAll('img, section, .scroll, h1')]
                .every((element) => {
                  const box = element.getBoundingClientRect();
                  return box.left >= 0 && box.right <= innerWidth + 0.5;
                })""")
            assert page.evaluate("""[...document.querySelectorAll('img')].every((image) =>
                image.complete && image.naturalWidth > 0)""")


def find_chromium() -> str | None:
    """Return the path of the browser, None where none is installed."""
    return next(filter(None, map(shutil.which, _NAMES)), None)


@contextmanager
def browser_page() -> Iterator[Page]:
    """Start Chromium and yield a tab of it."""
    program = find_chromium()
    assert program is not None
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        # Chromium reads commands from descriptor 3 and answers on 4.
        theirs_in, ours_out = os.pipe()
        ours_in, theirs_out = os.pipe()
        above = [fcntl.fcntl(descriptor, fcntl.F_DUPFD, 10)
                 for descriptor in (theirs_in, theirs_out)]

        def place_pipes() -> None:
            os.dup2(above[0], 3)
            os.dup2(above[1], 4)

        process = subprocess.Popen(
            [program, f'--user-data-dir={profile}', *_FLAGS], preexec_fn=place_pipes,
            pass_fds=(3, 4), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL)
        for descriptor in (theirs_in, theirs_out, *above):
            os.close(descriptor)
        try:
            yield Page(ours_out, ours_in)
        finally:
            os.close(ours_out)
            process.terminate()
            process.wait(timeout=TIMEOUT_S)
            os.close(ours_in)
