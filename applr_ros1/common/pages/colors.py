"""Colours of all web pages, for light and for dark pages.

Type and neutral colours are those of the documentation site (furo). The others are Okabe and Ito's,
which colour-blind people tell apart; those of light pages are darker, to be seen on white.
"""

from __future__ import annotations

from typing import Dict, NamedTuple, Sequence, Tuple


class Color(NamedTuple):
    """Colour as a CSS value, on light and on dark pages."""

    light: str
    dark: str


COLORS = {
    "ink": Color("#000000", "#cfd0d0"),
    "soft": Color("#5a5c63", "#9ca0a5"),  # second text
    "line": Color("#878787", "#81868d"),  # axes and frames
    "edge": Color("#e3e1e4", "#303335"),  # grids and borders
    "paper": Color("#ffffff", "#131416"),
    "raised": Color("#f8f9fb", "#1a1c1e"),  # ground of maps
    "hover": Color("#efeff4", "#26292d"),
    "brand": Color("#2757dd", "#5ca5ff"),  # links, controls, and the robot
    "bad": Color("#b84a00", "#ff8f4a"),  # failures
    "slow": Color("#d55e00", "#ff8a3d"),
    "fast": Color("#0072b2", "#56b4e9"),
    "goal": Color("#00805d", "#1fbf8f"),
    "mover": Color("#b0568a", "#dd94bb"),
    "obstacle": Color("#8d8f96", "#6f747b"),
    "cheap": Color("#00805d", "#1fbf8f"),  # trajectories of low cost
    "dear": Color("#d3d5da", "#3d4247"),  # trajectories of high cost
    # Parts of a whole, such as the critics' parts of a cost
    "part-0": Color("#0072b2", "#3d9be0"),
    "part-1": Color("#e69f00", "#e69f00"),
    "part-2": Color("#009e73", "#009e73"),
    "part-3": Color("#cc79a7", "#cc79a7"),
    "part-4": Color("#d55e00", "#d55e00"),
    "part-5": Color("#56b4e9", "#56b4e9"),
    "part-6": Color("#8d8f96", "#8d8f96"),
}
# Colours of methods. Vermilion is kept for failures.
METHOD_COLORS = (
    Color("#4a4a4a", "#c8c8c8"),
    Color("#009e73", "#1fbf8f"),
    Color("#0072b2", "#3d9be0"),
    Color("#b8578e", "#cc79a7"),
    Color("#b57c00", "#e69f00"),
    Color("#8a8300", "#f0e442"),
)
FIXED = {"dwa": 0, "applr": 1, "static": 2}  # colours of the methods that this package ships


def color_indices(methods: Sequence[str]) -> Dict[str, int]:
    """Return the index of each method's colour in METHOD_COLORS, the same on every page."""
    free_indices = [index for index in range(len(METHOD_COLORS)) if index not in FIXED.values()]
    other_methods = [method for method in methods if method not in FIXED]
    indices = {}
    for number, method in enumerate(other_methods):
        indices[method] = free_indices[number % len(free_indices)]
    for method in methods:
        indices.setdefault(method, FIXED.get(method, 0))
    return indices


def rgb(name: str) -> Tuple[int, int, int]:
    """Return one of COLORS, as on light pages, as red, green and blue from 0 to 255."""
    red, green, blue = bytes.fromhex(COLORS[name].light[1:])
    return red, green, blue


def css() -> str:
    """Return all colours as variables of CSS, --NAME and --method-INDEX."""
    colors = dict(COLORS)
    for index, color in enumerate(METHOD_COLORS):
        colors[f"method-{index}"] = color
    light_variables = []
    dark_variables = []
    for name, color in colors.items():
        light_variables.append(f"--{name}: {color.light};")
        dark_variables.append(f"--{name}: {color.dark};")
    return (
        f":root {{ {' '.join(light_variables)} }}\n"
        f"@media (prefers-color-scheme: dark) {{ :root {{ {' '.join(dark_variables)} }} }}"
    )
