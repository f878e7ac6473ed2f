# Copyright 2026 the startracker_ros authors
# SPDX-License-Identifier: Apache-2.0

"""
The picture of a page, as docs/gallery.md has them: python test/page_picture.py PAGE PNG [HEIGHT].

PAGE is a file or an address; the picture shows it in a window 900 px wide, and keeps its text.
"""

from pathlib import Path
import sys
import time

from browser import browser_page
from PIL import Image
from PIL.PngImagePlugin import PngInfo

WIDTH_PX, HEIGHT_PX, SETTLED_S = 900, 1000, 3.0


def main(name: str, picture: str, height: str = str(HEIGHT_PX)) -> None:
    """Write the picture."""
    with browser_page() as page:
        page.resize(WIDTH_PX, int(height))
        page.load(name if '://' in name else Path(name).resolve())
        # The live page asks for its first state.
        time.sleep(SETTLED_S)
        page.screenshot(Path(picture))
        # What tests compare with the results.
        kept = PngInfo()
        kept.add_itxt('text', page.evaluate('document.body.innerText'), zip=True)
        with Image.open(picture) as image:
            image.save(picture, pnginfo=kept, optimize=True)


if __name__ == '__main__':
    main(*sys.argv[1:])
