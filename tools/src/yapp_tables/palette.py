# SPDX-License-Identifier: GPL-2.0-or-later
"""Sixteen colours of controllers, on a light and on a dark background.

Each is at least 3:1 against its background, and at least 0.16 apart from each other and from the grey of Commands, in
the Oklab space, where people see differences of 0.02. The first ones are the furthest apart.
"""

LIGHT = (
    "#026fd7", "#fb1597", "#02400d", "#ab8a41", "#7f13f5", "#039227", "#aa1a0d", "#a3489d",
    "#d91dfc", "#2ca0ac", "#f84713", "#0816d0", "#987efc", "#630580", "#5c0109", "#012868",
)  # fmt: skip
DARK = (
    "#38c5fd", "#d00c98", "#227702", "#f2d710", "#877deb", "#30bd44", "#ee1401", "#fd67f4",
    "#fdcbf8", "#84f8d2", "#fc8c45", "#1d4ffd", "#53fe0a", "#9a0eef", "#905c3f", "#136b94",
)  # fmt: skip


def css() -> str:
    """Return the rules that give each data-colour its --own."""
    both = enumerate(zip(LIGHT, DARK, strict=True))
    rules = [f'[data-colour="{number}"] {{ --own: light-dark({light}, {dark}); }}' for number, (light, dark) in both]
    return "\n".join(rules)
