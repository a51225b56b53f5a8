"""The texts of a figure as they are drawn: their sizes, exponents too, and their boxes, by matplotlib."""

from contextlib import contextmanager
from itertools import combinations

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.mathtext import MathTextParser
from matplotlib.text import Text

# Smallest size of a text, points, and allowed overlap of texts or of the edge: about the leading of a line.
SMALLEST, ALLOWED = 6.0, 1.0
DPI = 100
# Height of a figure that leaves room for a caption on a page, mm.
TALLEST, INCH = 230.0, 25.4


@contextmanager
def recorded():
    """The texts that are drawn meanwhile: ticks beyond an axis, and notes outside of one, are not."""
    drawn, draw = [], Text.draw

    def record(text, renderer, *args, **kwargs):
        if text.get_visible() and text.get_text().strip():
            drawn.append((text, text.get_window_extent(renderer)))
        draw(text, renderer, *args, **kwargs)

    Text.draw = record
    try:
        yield drawn
    finally:
        Text.draw = draw


def smallest_sign(text):
    """Size of the smallest character of a text, of an exponent if it has one, points."""
    lines = text.get_text().split("\n") if text.get_parse_math() else ()
    drawn = [
        MathTextParser("path").parse(line, 72, text.get_fontproperties()) for line in lines if "$" in line
    ]
    return min((sign[1] for line in drawn for sign in line.glyphs), default=text.get_fontsize())


def faults(figure):
    """Return the faults of a figure: too high; texts too small, cut by its edge, or overlapping."""
    figure.set_dpi(DPI)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    with recorded() as drawn:
        canvas.draw()
    wide, high = (DPI * size for size in figure.get_size_inches())
    found = [f"high: {INCH * high / DPI:.0f} mm"] if INCH * high / DPI > TALLEST else []
    found += [
        f"small: {text.get_text()!r}, {size:.3g} pt"
        for text, _ in drawn
        if (size := smallest_sign(text)) < SMALLEST - 1e-9
    ]
    found += [
        f"cut: {text.get_text()!r}"
        for text, box in drawn
        if min(box.x0, box.y0, wide - box.x1, high - box.y1) < -ALLOWED
    ]
    return found + [
        f"overlap: {one.get_text()!r} and {other.get_text()!r}"
        for (one, a), (other, b) in combinations(drawn, 2)
        if min(a.x1, b.x1) - max(a.x0, b.x0) > ALLOWED and min(a.y1, b.y1) - max(a.y0, b.y0) > ALLOWED
    ]
