"""README's pictures, made from the pages: `python -m tests.support.pictures DRIVES.html WHY.html`.

The pages are those of an evaluation of two methods in one world, and of `./applr why`.
"""

import io
import sys
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from tests.support.browser import OPTIONS, PROGRAM

IMAGES = Path(__file__).parents[2] / "docs" / "images"
FRAME_S = 0.25  # interval between two frames of the animation
PAUSE_MS = 3000  # time for which its last frame stays
COLORS = 64  # number of colours of the animation
MARGIN_PX = 6  # margin of a picture


def main(drives: str, why: str) -> None:
    """Write side_by_side.gif and why.png into docs/images."""
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=PROGRAM, args=OPTIONS)
        animate(opened(browser, drives, 800), IMAGES / "side_by_side.gif")
        page = opened(browser, why, 1000)
        # `close` is the close-up of why.js, which has a scale once it is drawn.
        page.wait_for_function("close.scale > 0")
        picture = part(page, edge(page, "h1", "top"), edge(page, "section", "bottom"))
        picture.quantize(dither=Image.Dither.NONE).save(IMAGES / "why.png", optimize=True)
        browser.close()


def opened(browser, file: str, width: int):
    """Return a page of a file that is so wide [px]."""
    page = browser.new_page(viewport={"width": width, "height": 900}, reduced_motion="reduce")
    page.goto(Path(file).resolve().as_uri())
    return page


def animate(page, path: Path) -> None:
    """Write the drives on a page, from the map to the speeds, as an animation."""
    page.wait_for_function("view.scale > 0")
    # The animation looks like a page that plays in real time.
    page.evaluate("clock.isPlaying = true; clock.rate.value = 1")
    page.evaluate("clock.button.textContent = 'Pause'")
    top = edge(page, ".view", "top")
    bottom = edge(page, ".chart", "bottom")
    end_time = page.evaluate("clock.end")
    frames = []
    # The first frame, and one at the end or after it, where the clock stands still
    for frame_number in range(int(end_time / FRAME_S) + 2):
        page.evaluate(f"clock.set({frame_number * FRAME_S})")
        frames.append(part(page, top, bottom))
    # A frame in the middle has all colours. One palette for all frames keeps the file small.
    palette = frames[len(frames) // 2].quantize(
        COLORS, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
    )
    images = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    first_image, *later_images = images
    first_image.save(
        path,
        save_all=True,
        append_images=later_images,
        duration=[int(1000 * FRAME_S)] * len(later_images) + [PAUSE_MS],
        loop=0,
        optimize=True,
    )


def edge(page, selector: str, side: str) -> float:
    """Return the top or bottom of the first element that matches, on the whole page [px]."""
    script = f"element => element.getBoundingClientRect().{side} + scrollY"
    return page.locator(selector).first.evaluate(script)


def part(page, top: float, bottom: float) -> Image.Image:
    """Return the part of a page between two heights [px], with a margin."""
    top = max(top - MARGIN_PX, 0.0)
    height = bottom + MARGIN_PX - top
    rectangle = {"x": 0, "y": top, "width": page.viewport_size["width"], "height": height}
    png_bytes = page.screenshot(clip=rectangle, full_page=True)
    return Image.open(io.BytesIO(png_bytes)).convert("RGB")


if __name__ == "__main__":
    main(*sys.argv[1:])
