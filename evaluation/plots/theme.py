"""The colours of plots and page, each for a light and a dark background."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Colour:
    """One colour by its ``name``; plots are drawn with the light form, the page swaps it where it is dark."""

    name: str
    light: str
    dark: str

    @property
    def variable(self) -> str:
        """The colour as the page's style sheet knows it."""
        return f"var(--{self.name})"


INK = Colour("ink", "#1b1f24", "#e4e8ec")
PAPER = Colour("paper", "#ffffff", "#15191e")
MUTED = Colour("muted", "#57606a", "#a3adb8")
RULE = Colour("rule", "#d8dee4", "#343c45")
GRID = Colour("grid", "#b0b0b0", "#6b7480")
REFERENCE_GREY = Colour("reference", "#888888", "#98a1ab")
LINES = (
    Colour("blue", "#0072b2", "#4ba3e3"),
    Colour("vermilion", "#d55e00", "#f58442"),
    Colour("green", "#009e73", "#2cc79a"),
    Colour("pink", "#cc79a7", "#e59cc4"),
    Colour("amber", "#e69f00", "#f3ba3d"),
    Colour("sky", "#56b4e9", "#8fd3fb"),
    Colour("violet", "#7b4fa3", "#b18ad8"),
    Colour("brown", "#8c6d31", "#c5a562"),
)
"""Okabe and Ito's colours for the colour-blind, and two more."""
BOX = Colour("box", "#f2f6fa", "#1d242c")
LINK = Colour("link", "#0b5a8f", "#7cc0f2")
HEAT = Colour("heat", "#5fb0de", "#1b6494")
ALARM = Colour("alarm", "#f29a63", "#a4501b")
THEME = (INK, PAPER, MUTED, RULE, GRID, REFERENCE_GREY, *LINES, BOX, LINK, HEAT, ALARM)


def style_sheet() -> str:
    """Return the colours as CSS variables: dark ones on a screen that asks for them, light ones on paper."""
    light, dark = (" ".join(f"--{c.name}: {getattr(c, form)};" for c in THEME) for form in ("light", "dark"))
    return f":root {{ {light} }}\n@media screen and (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}"
