# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A page with the newest annotated image and the state in words, for the browser of a phone."""

from collections.abc import Mapping
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
import json
import socket
from string import Template
from threading import Thread
import time
from types import TracebackType
from typing import Any, Self

import erfa
import numpy as np
from startracker_ros.core.catalog.constellations import NAMES
from startracker_ros.ros.processes import HarnessError
from startracker_ros.tools.report.template import resource

# --- the figures as texts, the figure in the first line of each ---

_UNKNOWN = '-'


def state_texts(figures: Mapping[str, Any], reason: str, camera: str, age_s: float
                ) -> dict[str, str]:
    """
    Return the texts of LiveRig.figures() by label, with the reason of the state.

    age_s is the time since the newest frame, NaN before the first one.
    """
    age = f'\nnewest {age_s:.1f} s ago' if np.isfinite(age_s) else ''
    pointing = dict.fromkeys(
        ('right ascension', 'declination', 'roll', 'constellation'), _UNKNOWN)
    ra_deg, dec_deg, roll_deg = (figures[f'{name}_deg'] for name in ('ra', 'dec', 'roll'))
    if np.isfinite(ra_deg):
        ra_sigma, dec_sigma, roll_sigma = (f'sigma {_rounded(figures[f"{name}_sigma_arcsec"])} '
                                           'arcsec' for name in ('ra', 'dec', 'roll'))
        pointing = {
            'right ascension': f'{hours_text(ra_deg)}\n{ra_deg:.4f} deg\n{ra_sigma}',
            'declination': f'{degrees_text(dec_deg)}\n{dec_deg:+.4f} deg\n{dec_sigma}',
            'roll': f'{roll_deg:.4f} deg\n{roll_sigma}',
            'constellation': NAMES[figures['constellation']]}
    rate_deg_s = figures['rate_deg_s']
    return {
        'state': f'{figures["state"]}\n{reason}'.rstrip(), **pointing,
        'rate': f'{rate_deg_s:.4f} deg/s' if np.isfinite(rate_deg_s) else _UNKNOWN,
        'stars tracked': str(figures['stars']),
        'focus': focus_text(figures['fwhm_px']),
        'exposure': exposure_text(figures['exposure_ms'], figures['gain']),
        'camera': f'{camera}\n{figures["frames"]} frames{age}'.lstrip()}


def hours_text(ra_deg: float) -> str:
    """Return a right ascension in hours, minutes and seconds to 0.01 s."""
    _, parts = erfa.a2tf(2, np.radians(ra_deg))
    hours, minutes, seconds, hundredths = parts.item()
    return f'{hours % 24:02d}h{minutes:02d}m{seconds:02d}.{hundredths:02d}s'


def degrees_text(dec_deg: float) -> str:
    """Return a declination in degrees, minutes and seconds of arc to 0.1 arcsec."""
    sign, parts = erfa.a2af(1, np.radians(dec_deg))
    degrees, minutes, seconds, tenths = parts.item()
    return f'{sign.item().decode()}{degrees:02d}d{minutes:02d}\'{seconds:02d}.{tenths}"'


def focus_text(fwhm_px: float) -> str:
    """Return the width of the star images, which is smallest in focus."""
    return f'{fwhm_px:.2f} px\nFWHM of the stars' if np.isfinite(fwhm_px) else _UNKNOWN


def exposure_text(exposure_ms: float, gain: float) -> str:
    """Return exposure time and gain, as far as they are known."""
    if not np.isfinite(exposure_ms):
        return _UNKNOWN
    return f'{exposure_ms:.4g} ms' + (f'\ngain {gain:.4g}' if gain >= 0 else '')


def _rounded(value: float) -> str:
    """Return a number with two digits, without an exponent."""
    return np.format_float_positional(float(f'{value:.2g}'), trim='-')


# --- the page ---

THIS_MACHINE, _ANY_NETWORK = '127.0.0.1', '0.0.0.0'
PICTURE, _SMALL_PICTURE = 'sky.jpg', 'sky_small.jpg'
_SMALL_PX = 640  # the widest screen that has the small picture
# Width of the screen by 1024 px for which the marks of a picture are made.
_SHARES = {PICTURE: 1.0, _SMALL_PICTURE: 0.38}
_WANTED_S = 5.0
_LEFT_S = 30.0  # without an answer of a browser, as of a phone that is out of reach

_PAGE = Template("""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>startracker live</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><link rel="icon" href="data:,">
<style>$style
header, main { max-width: none; }
main { display: flex; flex-direction: column; padding: 0 0 1rem; }
#state { margin: 0; padding: 0.6rem 1rem;
  grid-template-columns: repeat(auto-fit, minmax(11rem, 1fr)); }
#state .wide { grid-column: span 2; }
#state div:first-child { border-left: 0.5rem solid var(--k); }
#state dd + dd { font-size: 0.875rem; }
#sky { width: 100%; }
.ended #sky { opacity: 0.35; }
@media (max-width: ${small}px) {
  #sky { order: -1; }
  #state { padding-inline: 0.6rem; grid-template-columns: 1fr 1fr; }
}
</style></head><body>
<header><h1>startracker live</h1></header>
<main><dl class="figures" id="state"></dl><img id="sky" alt="no image yet" hidden></main>
<script>
const KINDS = {TRACKING: 'good', ACQUIRING: 'warn', LOST: 'bad'}, WIDE = ['state', 'camera'];
const sky = document.getElementById('sky');
function show(state) {
  document.getElementById('state').replaceChildren(...Object.entries(state).map(
      ([name, text]) => {
        const card = document.createElement('div');
        const lines = text.split('\\n');
        card.append(...[name, ...lines].map((content, index) => {
          const element = document.createElement(index ? 'dd' : 'dt');
          element.textContent = content;
          return element;
        }));
        card.className = WIDE.includes(name) ? 'wide ' + (KINDS[lines[0]] ?? 'other') : '';
        return card;
      }));
}
async function refresh() {
  try {
    show(await (await fetch('state.json')).json());
    document.body.className = '';
    sky.src = (innerWidth <= $small ? '$small_picture' : '$picture') + '?' + Date.now();
    await sky.decode().then(() => { sky.hidden = false; }, () => {});
  } catch (error) {
    show({state: 'no answer\\nstartracker live has ended, or is not reached'});
    document.body.className = 'ended';
  }
  setTimeout(refresh, 1000);
}
const first = refresh();
</script></body></html>
""").substitute(style=resource('startracker_ros.tools.report', 'page.css'), picture=PICTURE,
                small_picture=_SMALL_PICTURE, small=_SMALL_PX)


class SkyPage:
    """
    Serves a page at an address of this machine; a context manager. port 0 takes any free one.

    HarnessError when address or port cannot be used.
    """

    def __init__(self, host: str, port: int) -> None:
        self.pictures: dict[str, bytes] = {}
        self.state: dict[str, str] = {}
        self._asked_s: dict[str, float] = {}
        page = self

        class Handler(BaseHTTPRequestHandler):
            """Answers GET; nothing of a request but its path is used."""

            timeout = _LEFT_S

            def do_GET(self) -> None:  # noqa: N802
                kind, content = page.content(self.path.partition('?')[0].removeprefix('/'))
                self.send_response(200 if kind else 404)
                self.send_header('Content-Type', kind or 'text/plain')
                self.send_header('Content-Length', str(len(content)))
                self.send_header('Cache-Control', 'no-store')
                self.end_headers()
                # A browser that has left meanwhile is not an error.
                with suppress(OSError):
                    self.wfile.write(content)

            def log_message(self, *arguments: Any) -> None:
                """Write no log: the terminal shows the state."""

        try:
            self._server = ThreadingHTTPServer((host, port), Handler)
        except OSError as error:
            raise HarnessError(f'{host} port {port}: {error.strerror}; choose another --host or '
                               '--port') from error
        name = socket.gethostname() if host == _ANY_NETWORK else host
        self.url = f'http://{name}:{self._server.server_port}/'
        self._thread = Thread(target=self._server.serve_forever, daemon=True)

    def wanted(self) -> dict[str, float]:
        """Return the pictures to be made, with the screens they are for: width by 1024 px."""
        since_s = time.monotonic() - _WANTED_S
        return {name: share for name, share in _SHARES.items()
                if name == PICTURE or self._asked_s.get(name, since_s) > since_s}

    def content(self, name: str) -> tuple[str, bytes]:
        """Return content type and content of a name, an empty type for no such page."""
        if not name:
            return 'text/html', _PAGE.encode()
        if name == 'state.json':
            return 'application/json', json.dumps(self.state).encode()
        if name in _SHARES:
            self._asked_s[name] = time.monotonic()
            if picture := self.pictures.get(name) or self.pictures.get(PICTURE):
                return 'image/jpeg', picture
        return '', b'not found'

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._server.shutdown()
        self._server.server_close()
