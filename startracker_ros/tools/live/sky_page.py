# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A page on this machine with the newest annotated image and the state, for a browser."""

from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
import json
from threading import Thread
from types import TracebackType
from typing import Any, Self

from startracker_ros.ros.processes import HarnessError
from startracker_ros.tools.report.template import resource

_PAGE = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>startracker live</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><link rel="icon" href="data:,">
<style>STYLE</style></head><body>
<header><h1>startracker live</h1></header>
<main><section><table id="state"></table></section>
<section><img id="sky" alt="no image yet" src="sky.jpg" width="100%"></section></main>
<script>
async function refresh() {
  const table = document.getElementById('state');
  try {
    const state = await (await fetch('state.json')).json();
    table.replaceChildren(...Object.entries(state).map(([name, value]) => {
      const row = document.createElement('tr');
      row.append(...[name, value].map(text => {
        const cell = document.createElement('td');
        cell.textContent = text;
        return cell;
      }));
      return row;
    }));
    document.getElementById('sky').src = 'sky.jpg?' + Date.now();
  } catch (error) {
    table.textContent = 'startracker live has ended';
  }
}
refresh();
setInterval(refresh, 1000);
</script></body></html>
""".replace('STYLE', resource('startracker_ros.tools.report', 'page.css'))


class SkyPage:
    """
    Serves a page on 127.0.0.1; a context manager. port 0 takes any free one.

    HarnessError when the port cannot be used.
    """

    def __init__(self, port: int) -> None:
        self.picture = b''
        self.state: dict[str, str] = {}
        page = self

        class Handler(BaseHTTPRequestHandler):
            """Answers GET; nothing of a request but its path is used."""

            def do_GET(self) -> None:  # noqa: N802
                kind, content = page.content(self.path.partition('?')[0])
                self.send_response(200 if kind else 404)
                self.send_header('Content-Type', kind or 'text/plain')
                self.send_header('Content-Length', str(len(content)))
                self.send_header('Cache-Control', 'no-store')
                self.end_headers()
                # A browser that has left meanwhile is no error.
                with suppress(ConnectionError):
                    self.wfile.write(content)

            def log_message(self, *arguments: Any) -> None:
                """Write no log: the terminal shows the state."""

        try:
            self._server = ThreadingHTTPServer(('127.0.0.1', port), Handler)
        except OSError as error:
            raise HarnessError(f'port {port}: {error.strerror}; choose another --port') from error
        self.url = f'http://127.0.0.1:{self._server.server_port}/'
        self._thread = Thread(target=self._server.serve_forever, daemon=True)

    def content(self, path: str) -> tuple[str, bytes]:
        """Return content type and content of a path, an empty type for no such page."""
        if path == '/':
            return 'text/html', _PAGE.encode()
        if path == '/state.json':
            return 'application/json', json.dumps(self.state).encode()
        if path == '/sky.jpg' and self.picture:
            return 'image/jpeg', self.picture
        return '', b'not found'

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        self._server.shutdown()
        self._server.server_close()
