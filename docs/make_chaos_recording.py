"""Makes the README's second picture: `splitslam demo --chaos` as it runs, as a GIF and for asciinema.

`python docs/make_chaos_recording.py`: runs the demo with its default script and writes docs/images/chaos.gif and
out/chaos.cast. Every frame is what the terminal showed; nothing is drawn by hand.
"""

from __future__ import annotations

import argparse
import io
import json
from pathlib import Path

import matplotlib
from PIL import Image, ImageDraw, ImageFont
from rich.color import Color
from rich.console import Console, RenderableType
from rich.segment import Segment
from rich.style import Style

from splitslam.chaos.demo import chaos_demo
from splitslam.chaos.script import read_script
from splitslam.chaos.table import tables
from splitslam.chaos.view import WIDTH, Snapshot, render
from splitslam.run.progress import Progress

_CELL = (8, 16)  # pixels of a character
_FONT_PX = 13
_BACKGROUND, _TEXT = (16, 20, 24), (214, 219, 226)
_BRAILLE = 0x2800
_DOTS = ((0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3))  # column and row, by Unicode's bits
_EVERY_S, _SPEED, _END_S = 0.5, 2.5, 6.0  # a frame of the GIF, how much faster it goes, how long the table stands

Frame = tuple[float, RenderableType]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gif", type=Path, default=Path("docs/images/chaos.gif"))
    parser.add_argument("--cast", type=Path, default=Path("out/chaos.cast"))
    arguments = parser.parse_args()
    shots: list[Snapshot] = []
    with Progress() as progress:
        result = chaos_demo(Path("out/demo"), progress, read_script("default"), shots.append)
    frames: list[Frame] = [(shot.now_s, render(shot)) for shot in shots if shot.now_s >= -1.0]
    frames.append((frames[-1][0] + _EVERY_S, tables(result)))
    rows = max(len(_lines(screen)) for _, screen in frames)
    write_cast(arguments.cast, frames, rows)
    write_gif(arguments.gif, frames, rows)
    print(arguments.gif, arguments.cast, sep="\n")


def write_cast(path: Path, frames: list[Frame], rows: int) -> None:
    """asciinema's format, version 2."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [json.dumps({"version": 2, "width": WIDTH, "height": rows, "title": "splitslam demo --chaos"})]
    begin_s = frames[0][0]
    for now_s, screen in frames:
        console = Console(file=io.StringIO(), width=WIDTH, force_terminal=True, color_system="truecolor")
        console.print(screen)
        assert isinstance(console.file, io.StringIO)
        shown = "\x1b[H\x1b[2J" + console.file.getvalue().replace("\n", "\r\n")
        lines.append(json.dumps([round(now_s - begin_s, 3), "o", shown]))
    path.write_text("\n".join(lines) + "\n")


def write_gif(path: Path, frames: list[Frame], rows: int) -> None:
    """Every half second of the demo, played faster; the table at the end stands for a while."""
    chosen, next_s = [], frames[0][0]
    for now_s, screen in frames[:-1]:
        if now_s >= next_s:
            chosen.append(screen)
            next_s = now_s + _EVERY_S
    images = [draw(screen, rows) for screen in (*chosen, frames[-1][1])]
    seen = Image.new("RGB", (images[0].width, images[0].height * 2))
    for k, image in enumerate((images[len(images) // 2], images[-1])):
        seen.paste(image, (0, k * image.height))
    palette = seen.quantize(64, dither=Image.Dither.NONE)
    flat = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    durations_ms = [round(1000 * _EVERY_S / _SPEED)] * len(chosen) + [round(1000 * _END_S)]
    flat[0].save(path, save_all=True, append_images=flat[1:], duration=durations_ms, loop=0, optimize=True)


def draw(screen: RenderableType, rows: int) -> Image.Image:
    """The screen's character cells; braille as dots, since few fonts have it."""
    width, height = _CELL
    image = Image.new("RGB", (WIDTH * width, rows * height), _BACKGROUND)
    pen = ImageDraw.Draw(image)
    fonts = [_font("DejaVuSansMono.ttf"), _font("DejaVuSansMono-Bold.ttf")]
    for row, line in enumerate(_lines(screen)):
        column = 0
        for segment in line:
            style = segment.style or Style()
            for character in segment.text:
                _draw_cell(pen, column * width, row * height, character, style, fonts)
                column += 1
    return image


def _draw_cell(pen: ImageDraw.ImageDraw, x: int, y: int, character: str, style: Style, fonts: list) -> None:
    width, height = _CELL
    colour = _rgb(style.color, _TEXT)
    if style.bgcolor is not None:
        pen.rectangle((x, y, x + width - 1, y + height - 1), fill=_rgb(style.bgcolor, _BACKGROUND))
    bits = ord(character) - _BRAILLE
    if 0 <= bits < 256:
        for bit, (column, row) in enumerate(_DOTS):
            if bits >> bit & 1:
                left, top = x + 1 + 4 * column, y + 1 + 4 * row
                pen.rectangle((left, top, left + 1, top + 1), fill=colour)
    elif not character.isspace():
        pen.text((x, y), character, fill=colour, font=fonts[bool(style.bold)])


def _lines(screen: RenderableType) -> list[list[Segment]]:
    console = Console(width=WIDTH, force_terminal=True, color_system="truecolor", file=io.StringIO())
    return console.render_lines(screen, pad=False)


def _rgb(colour: Color | None, default: tuple[int, int, int]) -> tuple[int, int, int]:
    return default if colour is None or colour.is_default else tuple(colour.get_truecolor())


def _font(name: str) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(str(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name), _FONT_PX)


if __name__ == "__main__":
    main()
