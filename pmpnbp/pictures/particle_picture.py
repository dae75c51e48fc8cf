"""Why does a particle weigh what it does, as far as a scan shows it? Three panels: the depth that was observed, the
depth of the part rendered alone at the particle's pose, and what the pixel score (eq. 10) makes of their difference.

Drawn in the pixels of the inference's working image, as they are what is scored, cut out around the part.
"""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.pictures.palette import DARK_PAPER, INK, KIND_COLOURS, KIND_NAMES, PAPER, Colour, rgb
from pmpnbp.potentials.pixel_kinds import PixelKind, pixel_kinds
from pmpnbp.potentials.unary import PixelScore, render_part
from pmpnbp.scene.work_image import turned_back

# Depth from near to far, sRGB: lightness falls evenly.
RAMP = ("#f6efd9", "#c9d3b0", "#86b1a0", "#4d8797", "#2f5a80", "#252f57")
NARROWEST, LONGEST = 480, 1600
# Of the part's extent this much is shown around it, and at least so many pixels of the working image across.
MARGIN, FEWEST = 0.35, 36
# Height to width of a panel.
ASPECT = 0.86
PANELS, LEGEND_COLUMNS = 3, 2

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Style:
    """Colours and sizes of a picture `width` pixels wide."""

    width: int
    paper: Colour
    ink: Colour
    quiet: Colour
    empty: Colour

    @property
    def text(self) -> int:
        """Height of letters, pixels."""
        return max(round(self.width / 54), 10)

    @property
    def letters(self) -> ImageFont.ImageFont | ImageFont.FreeTypeFont:
        """The font, of that height."""
        return ImageFont.load_default(self.text)

    @property
    def gap(self) -> int:
        """Between panels, pixels."""
        return max(round(self.width / 60), 6)

    @property
    def panel(self) -> tuple[int, int]:
        """Width and height of a panel, pixels."""
        across = (self.width - (PANELS + 1) * self.gap) // PANELS
        return across, round(across * ASPECT)


def particle_picture(
    problem: Problem,
    report: IterationReport,
    node: int,
    index: int,
    *,
    view: int = 0,
    width: int = 720,
    dark: bool = False,
) -> bytes:
    """A PNG `width` pixels wide about particle `index` of part `node`, in view `view` of the iteration's scans.

    dark : for a dark page. The tolerance is the iteration's.
    """
    seen = problem.observation.views[view]
    rendered = render_part(seen.camera, problem.surfaces, node, report.belief.poses[node, index])
    score = problem.plain_score(report.tolerance)
    kinds = pixel_kinds(seen.depth, seen.category, rendered, score.tolerance)
    counts = {kind: int(np.count_nonzero(kinds == kind)) for kind in KIND_COLOURS}
    depth, rendered = (turned_back(image, seen.turn, seen.camera) for image in (seen.depth, rendered))
    kinds = turned_back(kinds, seen.turn, seen.camera)
    rows, columns = cut_out(rendered > 0, ASPECT)
    style = _style(width, dark)
    cut_depth, cut_rendered = depth[rows, columns], rendered[rows, columns]
    span = _span(cut_depth, cut_rendered)
    outline = _rim(rendered > 0)[rows, columns]
    observed = _depth_colours(cut_depth, span, style)
    alone = _depth_colours(cut_rendered, span, style)
    panels = (
        ("Observed depth", _with_rim(observed, outline, style)),
        ("Rendered at this pose", np.where(cut_rendered[..., None] > 0, alone, _faded(observed, style))),
        ("Difference", _kind_colours(kinds[rows, columns], _faded(observed, style))),
    )
    return _png(_composed(panels, counts, span, score, style))


def cut_out(covered: NDArray[np.bool_], aspect: float) -> tuple[slice, slice]:
    """Rows and columns of an image (h, w) around what is covered, height to width as `aspect` where the image has room;
    all of the image where nothing is."""
    height, width = covered.shape
    if not covered.any():
        return slice(0, height), slice(0, width)
    down, across = np.flatnonzero(covered.any(axis=1)), np.flatnonzero(covered.any(axis=0))
    size = max(float(np.ptp(across) + 1), (np.ptp(down) + 1) / aspect) * (1 + 2 * MARGIN)
    wide = min(max(round(size), FEWEST), width)
    high = min(round(wide * aspect), height)
    return _around(int(down[0] + down[-1]) // 2, high, height), _around(int(across[0] + across[-1]) // 2, wide, width)


def _around(middle: int, length: int, limit: int) -> slice:
    first = min(max(middle - length // 2, 0), limit - length)
    return slice(first, first + length)


def _style(width: int, dark: bool) -> Style:
    if dark:
        return Style(width, rgb(DARK_PAPER), rgb("#e6e9ee"), rgb("#9aa3b0"), rgb("#232a34"))
    return Style(width, rgb(PAPER), rgb(INK), rgb("#5b6472"), rgb("#ffffff"))


def _span(depth: NDArray[np.float32], rendered: NDArray[np.float32]) -> tuple[float, float]:
    """The depths, metres, that the ramp goes from and to: around the part, so that its shape is seen."""
    own = rendered[rendered > 0]
    used = own if own.size else depth[depth > 0]
    if not used.size:
        return 0.0, 1.0
    low, high = float(used.min()), float(used.max())
    reach = max(0.5 * (high - low), 0.06)
    return low - reach, high + reach


def _depth_colours(depth: NDArray[np.float32], span: tuple[float, float], style: Style) -> Picture:
    share = np.clip((depth - span[0]) / (span[1] - span[0]), 0, 1) * (len(RAMP) - 1)
    stops = np.array([rgb(colour) for colour in RAMP], dtype=np.float64)
    lower = np.minimum(share.astype(int), len(RAMP) - 2)
    part = (share - lower)[..., None]
    colours = stops[lower] * (1 - part) + stops[lower + 1] * part
    colours[depth <= 0] = style.empty
    return np.round(colours).astype(np.uint8)


def _faded(picture: Picture, style: Style) -> Picture:
    """In greys close to the paper, to stand behind something."""
    grey = picture.astype(np.float64).mean(axis=-1, keepdims=True)
    paper = np.array(style.paper, dtype=np.float64)
    return np.round(0.76 * paper + 0.24 * np.repeat(grey, 3, axis=-1)).astype(np.uint8)


def _kind_colours(kinds: NDArray[np.uint8], behind: Picture) -> Picture:
    picture = behind.copy()
    for kind, colour in KIND_COLOURS.items():
        picture[kinds == kind] = rgb(colour)
    return picture


def _rim(covered: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Covered pixels with a neighbour that is not."""
    inside = np.pad(covered, 1)
    return covered & ~(inside[:-2, 1:-1] & inside[2:, 1:-1] & inside[1:-1, :-2] & inside[1:-1, 2:])


def _with_rim(picture: Picture, rim: NDArray[np.bool_], style: Style) -> Picture:
    shown = picture.copy()
    shown[rim] = np.round(0.35 * shown[rim] + 0.65 * np.array(rgb("#d81b72"))).astype(np.uint8)
    return shown


def _composed(
    panels: tuple[tuple[str, Picture], ...],
    counts: dict[PixelKind, int],
    span: tuple[float, float],
    score: PixelScore,
    style: Style,
) -> Image.Image:
    across, down = style.panel
    line = round(1.5 * style.text)
    entries = _legend(counts, score)
    rows = -(-len(entries) // LEGEND_COLUMNS)
    top = style.gap + line
    height = top + down + style.gap + line + rows * line + style.gap
    image = Image.new("RGB", (style.width, height), style.paper)
    draw = ImageDraw.Draw(image)
    below = top + down + style.gap + style.text // 2
    notes = ("", "the part alone, over the scan", f"explained: within {1000 * score.tolerance:.0f} mm")
    for place, ((title, panel), note) in enumerate(zip(panels, notes, strict=True)):
        left = style.gap + place * (across + style.gap)
        draw.text((left, style.gap), title, font=style.letters, fill=style.ink)
        image.paste(_enlarged(panel, across, down, style), (left, top))
        draw.text((left, below), note, font=style.letters, fill=style.quiet, anchor="lm")
    _draw_ramp(image, draw, span, below, style)
    for number, entry in enumerate(entries):
        left = style.gap + number // rows * ((style.width - style.gap) // LEGEND_COLUMNS)
        _draw_entry(draw, left, below + line + number % rows * line + style.text // 4, entry, style)
    return image


def _enlarged(panel: Picture, across: int, down: int, style: Style) -> Image.Image:
    """The panel as large as there is room, its pixels kept apart."""
    scale = min(across / panel.shape[1], down / panel.shape[0])
    size = round(panel.shape[1] * scale), round(panel.shape[0] * scale)
    if abs(size[0] - across) <= 4 and abs(size[1] - down) <= 4:  # a working pixel is not shown in parts
        size = across, down
    framed = Image.new("RGB", (across, down), style.empty)
    shown = Image.fromarray(panel).resize(size, Image.Resampling.NEAREST)
    framed.paste(shown, ((across - size[0]) // 2, (down - size[1]) // 2))
    return framed


def _draw_ramp(
    image: Image.Image, draw: ImageDraw.ImageDraw, span: tuple[float, float], middle: int, style: Style
) -> None:
    """Which colour is which depth, under the first panel, at the height `middle`."""
    across, _ = style.panel
    near, far = f"{span[0]:.2f} m", f"{span[1]:.2f} m"
    start = style.gap + round(draw.textlength(near, font=style.letters)) + style.text // 2
    length = max(across - 2 * (start - style.gap), 2)
    ramp = _depth_colours(np.linspace(*span, length, dtype=np.float32)[None], span, style)
    bar = Image.fromarray(np.repeat(ramp, max(style.text // 2, 4), axis=0))
    image.paste(bar, (start, middle - bar.height // 2))
    draw.text((style.gap, middle), near, font=style.letters, fill=style.quiet, anchor="lm")
    draw.text((start + length + style.text // 2, middle), far, font=style.letters, fill=style.quiet, anchor="lm")


def _draw_entry(
    draw: ImageDraw.ImageDraw, left: int, middle: int, entry: tuple[Colour, int, str, str], style: Style
) -> None:
    """One line of the legend: colour, how many pixels, what they are, what each is worth."""
    colour, count, name, worth = entry
    box = style.text
    draw.rectangle((left, middle - box // 2, left + box, middle + box // 2), fill=colour)
    number_ends = left + round(1.5 * box + draw.textlength("00000", font=style.letters))
    draw.text((number_ends, middle), str(count), font=style.letters, fill=style.ink, anchor="rm")
    name_starts = number_ends + round(0.6 * box)
    draw.text((name_starts, middle), name, font=style.letters, fill=style.ink, anchor="lm")
    after = name_starts + round(draw.textlength(name, font=style.letters) + 0.6 * box)
    draw.text((after, middle), worth, font=style.letters, fill=style.quiet, anchor="lm")


def _legend(counts: dict[PixelKind, int], score: PixelScore) -> list[tuple[Colour, int, str, str]]:
    """Of each kind its colour, how many pixels are of it, its name, and what such a pixel is worth."""
    worth = {
        PixelKind.EXPLAINED: "up to +1",
        PixelKind.ON_SUPPORT: f"up to +{score.support_reward:g}",
        PixelKind.GOES_ON: f"up to +{score.continued_reward:g}",
        PixelKind.IN_FRONT: f"{-score.occlusion_cost:g}",
        PixelKind.SEEN_THROUGH: f"{-score.free_space_cost:g}",
        PixelKind.NO_DEPTH: "0",
        PixelKind.OUTSIDE_ROI: "0",
    }
    robust = score.form == "robust"
    return [
        (rgb(KIND_COLOURS[kind]), counts[kind], KIND_NAMES[kind], f"{worth[kind]} each" if robust else "")
        for kind in KIND_COLOURS
    ]


def _png(image: Image.Image) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, "png", compress_level=6)
    return buffer.getvalue()
