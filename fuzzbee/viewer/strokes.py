"""Letters and digits as strokes: text of any size and colour among lines, which stays crisp."""

from functools import cache

Point = tuple[float, float]
Strokes = tuple[tuple[Point, ...], ...]

WIDTH, HEIGHT = 4, 6  # of a glyph, in its own units; y points down
ADVANCE = 6.0  # from one glyph to the next

# Strokes are separated by "|"; each corner is its x and its y.
GLYPHS = {
    "0": "00 40 46 06 00",
    "1": "11 20 26",
    "2": "00 40 43 03 06 46",
    "3": "00 40 46 06|03 43",
    "4": "36 30 04 44",
    "5": "40 00 03 43 46 06",
    "6": "40 00 06 46 43 03",
    "7": "00 40 16",
    "8": "00 40 46 06 00|03 43",
    "9": "43 03 00 40 46 06",
    "A": "06 00 40 46|03 43",
    "B": "00 06 36 45 44 33 03|33 42 41 30 00",
    "C": "40 00 06 46",
    "D": "00 06 36 45 41 30 00",
    "E": "40 00 06 46|03 33",
    "F": "40 00 06|03 33",
    "G": "40 00 06 46 43 23",
    "H": "00 06|40 46|03 43",
    "I": "10 30|20 26|16 36",
    "J": "40 46 06 05",
    "K": "00 06|40 03 46",
    "L": "00 06 46",
    "M": "06 00 23 40 46",
    "N": "06 00 46 40",
    "O": "00 40 46 06 00",
    "P": "06 00 40 43 03",
    "Q": "00 40 46 06 00|24 46",
    "R": "06 00 40 43 03|13 46",
    "S": "41 30 10 01 02 44 45 36 16 05",
    "T": "00 40|20 26",
    "U": "00 06 46 40",
    "V": "00 26 40",
    "W": "00 16 23 36 40",
    "X": "00 46|40 06",
    "Y": "00 23 40|23 26",
    "Z": "00 40 06 46",
    "+": "03 43|21 25",
    "-": "03 43",
    ".": "25 26",
    ",": "25 17",
    ":": "21 22|24 25",
    "!": "20 24|25 26",
    "?": "00 40 43 23 24|25 26",
    "/": "06 40",
    "(": "30 12 14 36",
    ")": "10 32 34 16",
    "=": "02 42|04 44",
    "_": "06 46",
    "°": "10 30 32 12 10",
    "±": "02 42|20 24|06 46",
}


def width(text: str, size: float) -> float:
    """How wide a text of capitals ``size`` high is."""
    return max(0.0, len(text) * ADVANCE - (ADVANCE - WIDTH)) * size / HEIGHT


def text_strokes(text: str, at: Point, size: float, align: str = "centre") -> list[list[Point]]:
    """The lines of a text whose middle, left or right end is ``at``; y points down.

    Small letters are drawn as capitals; what has no glyph is left blank.
    """
    scale = size / HEIGHT
    left = at[0] - {"left": 0.0, "centre": 0.5, "right": 1.0}[align] * width(text, size)
    top = at[1] - size / 2.0
    return [
        [(left + (n * ADVANCE + x) * scale, top + y * scale) for x, y in stroke]
        for n, letter in enumerate(text.upper())
        for stroke in _glyph(letter)
    ]


@cache
def _glyph(letter: str) -> Strokes:
    strokes = GLYPHS.get(letter, "").split("|")
    return tuple(tuple((float(c[0]), float(c[1])) for c in s.split()) for s in strokes if s)
