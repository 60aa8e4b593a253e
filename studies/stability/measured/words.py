"""The page's words, and tables as Markdown."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

from .run import NOISE

FIRST = "sphere, no noise"
SCENES = (FIRST, f"sphere, {100 * NOISE:g} % noise", "cow, no noise", f"cow, {100 * NOISE:g} % noise")


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """As Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def wrapped(paragraph: str, indent: str = "") -> str:
    """Lines of at most 120 characters, whatever was filled in."""
    return textwrap.fill(" ".join(paragraph.split()), 120, subsequent_indent=indent, break_long_words=False,
                         break_on_hyphens=False)


HEAD = """# Measured materials

Made by `{command}` ({renderer}, {minutes:.1f} minutes of processor time). DIR and OBJ are not in the repository.

{count} materials of the MERL database (Matusik et al. 2003), which nobody made with a shader: what does the product
say of them, and does it look right under other lamps? Beside it stand the Cook-Torrance fits that Ngan et al. 2005 and
Low et al. 2012 (by two losses, E1 and E2) published, each evaluated with its own model (Beckmann's distribution,
V-grooves, its own Fresnel term; colour in the highlight).

**Truth** is a small network per material (Sztrajman et al. 2021), in float64. It is an approximation: sharp peaks are
smoother than in the measurement, to which the published fits were fitted. That is unfair to them where highlights are
narrow; `cook-torrance` below is their model fitted to the same data as ours, which is fair. What is nearly black the
networks do not know well (black-obsidian is red in rings); it counts all the same.

**Scene.** A sphere ({texels} texels, those up to 80° about its front) and a cow, seen by 2 cameras under {lamps} lamps;
an observation is radiance over irradiance, without noise or with 1 %. **Held out** are {held_out} other lamps, from
one of the cameras and from a third. Only texels that are lit and seen (cosines above 0.1) count, as the pictures show
them.

**Display error**: root mean square error of the picture, sRGB-encoded and clipped at white, exposed so that the truth's
95th percentile of luminance is 0.8. **Relative error**: mean absolute error of radiance over its mean; nothing is
clipped, so that highlights weigh as much as their light.

**`auto`** begins with the rung that the evidence inside the fit prefers. Then a third of the lamps is left out, three
times, and several models predict the radiance that they show: Lambert, that rung, one value for the whole material
(without and with Specular IOR Level and, where Metallic is not 0, Metallic), parts of it, and a value a texel drawn to
the material's. The rung of the evidence stays if it leads clearly; else the smallest model within the scatter (5 to
8 %) is solved for ([0014](../decisions/0014-prediction-has-the-last-word.md)). It sees neither the held-out lamps nor
the published fits.

**One value**: a measured material is uniform, so its maps are one value: the medians over the 15 % of texels that came
nearest to a highlight. **Joint fit**: all observations of all texels fitted at once in float64, not by the product.
"""

PICTURES = """
![Fit quality, and roughness by loss](measured.png)

![Spheres under two held-out lamps, from the held-out camera](measured-spheres.jpg)

A dozen spheres by rank, from where the maps of `auto` do best beside the best published fit (top left, then down) to
where they do worst (bottom right); display errors below.
"""

METHODS = """How many materials are relit no worse than by each published fit (Ngan published 86 of them), and by the
best of them for that material; "refitted" is Low's model fitted to our data by our loss (8 numbers, colour in the
highlight). The first rows of a scene are the rungs of the model ladder, a value a texel, when they are asked for;
`auto` is the default.
"""

KIND = """Medians of the display error on the sphere without noise; then for how many materials the maps of `auto` are
at or below the best published fit, by each error, and for how many `auto` took Metallic.
"""

LOSSES = """The same observations, one value, by the loss that is minimised. relative: the product's, squares over the
larger of the observation and the typical one; squares, log (ln(1 + f cos_l)) and cube root of f cos_l; robust: the
product's through Cauchy's function.
"""

COLUMNS = """Roughness is the node's, sqrt(alpha). That of the published fits is sqrt(m) of Beckmann's distribution: a
GGX lobe that is as wide at half its height has 1.14 times that roughness, but longer tails, so that no conversion is
right everywhere. Ngan's colours are scaled as MERL's. `auto`: its one value on the sphere without noise; of two lobes
the first. Losses: joint fits of `one-lobe-specular`; so is the base colour "joint".
"""

ERRORS = """Display errors on the sphere without noise (relative ones where it says so); losses are joint fits of
`one-lobe-specular`. The winner is that of the maps of `auto` and the published fits.
"""
