# SPDX-License-Identifier: GPL-2.0-or-later
"""python -m yapp_tables."""

from .cli import run

run()
