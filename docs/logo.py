"""Draw the logo and icon of the pages, a swing that decays: python docs/logo.py."""

import sys
from pathlib import Path

import numpy as np

LOGO = Path(__file__).resolve().parent / "_static" / "logo.svg"
SIZE = 64
MARGIN = 5.0
PERIODS = 3.25
DECAY = 2.2
INK = "#2a78b8"
PALE = "#e07b39"


def drawn() -> str:
    """Return the picture as SVG: the swing, and its envelope above and below."""
    time = np.linspace(0.0, 1.0, 160)
    envelope = np.exp(-DECAY * time)
    swing = envelope * np.cos(2.0 * np.pi * PERIODS * time)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIZE} {SIZE}">',
        "<title>A swing that decays</title>",
        '<g fill="none" stroke-linecap="round" stroke-linejoin="round">',
        _line(time, envelope, f'stroke="{PALE}" stroke-width="2.5"'),
        _line(time, -envelope, f'stroke="{PALE}" stroke-width="2.5"'),
        _line(time, swing, f'stroke="{INK}" stroke-width="4.5"'),
        "</g>",
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _line(time: np.ndarray, height: np.ndarray, look: str) -> str:
    across = MARGIN + (SIZE - 2.0 * MARGIN) * time
    down = SIZE / 2.0 - (SIZE / 2.0 - MARGIN) * height
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in zip(across, down, strict=True))
    return f'<polyline {look} points="{points}"/>'


def main() -> int:
    """Write the picture."""
    LOGO.write_text(drawn(), encoding="utf-8", newline="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
