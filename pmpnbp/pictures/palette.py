"""Which colour has a part, and which a pixel that fits it or does not? One list for every picture, page and 3D view.

Parts have six hues that stay apart for readers with any of the usual colour vision deficiencies and on a grey scan;
further parts take them again, darker, then lighter. tests/pictures/test_palette.py measures how far apart they are.
"""

from __future__ import annotations

from colorsys import hls_to_rgb, rgb_to_hls
from functools import cache

from pmpnbp.potentials.pixel_kinds import PixelKind

# sRGB, hexadecimal. Neighbours in the list differ most, as parts are numbered along the kinematic tree.
PART_COLOURS = ("#4a72cf", "#f0a33c", "#23a374", "#b56fae", "#82dcec", "#b43d22")
# Outlines and text, and what they stand on.
INK = "#1f2630"
PAPER = "#f3f4f6"
# What text and pictures stand on where the page is dark, and the contrast to it that a part's colour has to have.
DARK_PAPER = "#14181f"
STANDS_OUT = 3.0

# Of the kinds of covered pixels, apart for readers with any colour vision deficiency: after Okabe and Ito.
KIND_COLOURS = {
    PixelKind.EXPLAINED: "#0072b2",
    PixelKind.ON_SUPPORT: "#56b4e9",
    PixelKind.GOES_ON: "#009e73",
    PixelKind.IN_FRONT: "#f0c83c",
    PixelKind.SEEN_THROUGH: "#c8430a",
    PixelKind.NO_DEPTH: "#8a8f98",
    PixelKind.OUTSIDE_ROI: "#b9a3c9",
}
KIND_NAMES = {
    PixelKind.NOT_COVERED: "not covered",
    PixelKind.EXPLAINED: "explained",
    PixelKind.ON_SUPPORT: "on a support plane",
    PixelKind.GOES_ON: "on a surface that goes on",
    PixelKind.IN_FRONT: "something in front",
    PixelKind.SEEN_THROUGH: "free space violated",
    PixelKind.NO_DEPTH: "no depth",
    PixelKind.OUTSIDE_ROI: "outside the region",
}

# Lightness of a colour's second and third use, as shares of the way to black and to white.
_DARKER, _LIGHTER = 0.38, 0.55
_ON_DARK = 0.0, 0.35, 0.7

Colour = tuple[int, int, int]


def part_colour(part: int) -> Colour:
    """Red, green and blue, 0 to 255 sRGB, of the part with this number."""
    use, hue = divmod(part, len(PART_COLOURS))
    colour = rgb(PART_COLOURS[hue])
    if not use % 3:
        return colour
    h, lightness, saturation = rgb_to_hls(*(value / 255 for value in colour))
    lightness = lightness * (1 - _DARKER) if use % 3 == 1 else lightness + (1 - lightness) * _LIGHTER
    return _of_hls(h, lightness, saturation)


def part_colour_on_dark(part: int) -> Colour:
    """The same hue where the page is dark: there a hue's second and third use are lighter, and none is so dark that it
    does not stand out."""
    use, hue = divmod(part, len(PART_COLOURS))
    h, lightness, saturation = rgb_to_hls(*(value / 255 for value in part_colour(hue)))
    lightness += (1 - lightness) * _ON_DARK[use % 3]
    while contrast(colour := _of_hls(h, lightness, saturation), rgb(DARK_PAPER)) < STANDS_OUT:
        lightness += 0.01
    return colour


def contrast(one: Colour, other: Colour) -> float:
    """1 to 21: how far two colours differ in light, as WCAG 2 counts it."""
    lighter, darker = sorted((_luminance(one), _luminance(other)), reverse=True)
    return (lighter + 0.05) / (darker + 0.05)


@cache
def part_colours(count: int, dark: bool = False) -> tuple[Colour, ...]:
    """The colours of parts 0 to `count` - 1. dark : where the page is dark"""
    return tuple(map(part_colour_on_dark if dark else part_colour, range(count)))


def rgb(colour: str) -> Colour:
    """`#rrggbb` as red, green and blue, 0 to 255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)


def hexadecimal(colour: Colour) -> str:
    """Red, green and blue, 0 to 255, as `#rrggbb`."""
    return "#" + "".join(f"{value:02x}" for value in colour)


def _of_hls(hue: float, lightness: float, saturation: float) -> Colour:
    red, green, blue = hls_to_rgb(hue, lightness, saturation)
    return round(red * 255), round(green * 255), round(blue * 255)


def _luminance(colour: Colour) -> float:
    linear = [
        part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in (c / 255 for c in colour)
    ]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]
