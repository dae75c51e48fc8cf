"""Which colour has a part? One list for every picture, page and 3D view, so that a part looks the same everywhere.

Six hues that stay apart for readers with any of the usual colour vision deficiencies and on a grey scan; further parts
take them again, darker, then lighter. tests/app/test_palette.py measures how far apart they are.
"""

from __future__ import annotations

from colorsys import hls_to_rgb, rgb_to_hls

# sRGB, hexadecimal. Neighbours in the list differ most, as parts are numbered along the kinematic tree.
PART_COLOURS = ("#4a72cf", "#f0a33c", "#23a374", "#b56fae", "#82dcec", "#b43d22")
# Outlines and text, and what they stand on.
INK = "#1f2630"
PAPER = "#f3f4f6"

# Lightness of a colour's second and third use, as shares of the way to black and to white.
_DARKER, _LIGHTER = 0.38, 0.55

Colour = tuple[int, int, int]


def part_colour(part: int) -> Colour:
    """Red, green and blue, 0 to 255 sRGB, of the part with this number."""
    use, hue = divmod(part, len(PART_COLOURS))
    red, green, blue = (value / 255 for value in rgb(PART_COLOURS[hue]))
    if use % 3:
        h, lightness, saturation = rgb_to_hls(red, green, blue)
        lightness = lightness * (1 - _DARKER) if use % 3 == 1 else lightness + (1 - lightness) * _LIGHTER
        red, green, blue = hls_to_rgb(h, lightness, saturation)
    return round(red * 255), round(green * 255), round(blue * 255)


def part_colours(count: int) -> tuple[Colour, ...]:
    """The colours of parts 0 to `count` - 1."""
    return tuple(part_colour(part) for part in range(count))


def rgb(colour: str) -> Colour:
    """`#rrggbb` as red, green and blue, 0 to 255."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
